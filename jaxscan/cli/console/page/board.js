// Where the board was, and where it is wanted, as pictures.
import { at, fill, make } from "/shared.js";

const DONE = "#1f8f5f", WANTED = "#4fb3ff", NOW = "#ffb000", EMPTY = "#8883";

export function showGuide(state) {
  const guide = state.guide, shown = Boolean(guide) && Boolean(state.placing);
  at("guide").hidden = !shown;
  if (!shown) return;
  const { kind, number, total, at_deg: turned } = state.placing;
  at("pose-number").textContent = `${kind === "free" ? "pose" : "standing place"} ${number + 1} of ${total}${turned ? `, the table at ${turned.toFixed(0)}°` : ""}`;
  at("placing").hidden = state.doing !== "placing";
  fill(at("advice"), guide.advice.map((text) => make("li", text)));
  const pose = guide.pose;
  at("pose").textContent = pose ? `the board is seen: tilted ${pose.tilt_deg.toFixed(0)}°, about ${pose.depth_m.toFixed(2)} m away` : guide.problem;
  covered(guide);
  tilts(guide);
  depths(guide);
}

function covered({ covered, corners, next }) {
  const canvas = at("covered"), pen = canvas.getContext("2d"), rows = covered.length, columns = covered[0].length;
  const w = canvas.width / columns, h = canvas.height / rows;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  covered.forEach((row, r) => row.forEach((good, c) => {
    pen.fillStyle = good ? DONE : corners[r][c] ? "#1f8f5f66" : EMPTY;
    pen.fillRect(c * w + 2, r * h + 2, w - 4, h - 4);
  }));
  pen.strokeStyle = WANTED; pen.lineWidth = 4;
  pen.strokeRect(next.at[0] * canvas.width - 0.4 * w, next.at[1] * canvas.height - 0.4 * h, 0.8 * w, 0.8 * h);
}

function tilts({ pose, next, min_tilt_deg }) {
  const canvas = at("tilts"), pen = canvas.getContext("2d"), r = canvas.width / 2, scale = (r - 6) / 60;
  const spot = (tilt, towards, colour) => {
    const a = (towards * Math.PI) / 180;
    pen.fillStyle = colour; pen.beginPath();
    pen.arc(r + tilt * scale * Math.cos(a), r + tilt * scale * Math.sin(a), 8, 0, 7); pen.fill();
  };
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = EMPTY; pen.lineWidth = 2;
  for (const tilt of [min_tilt_deg, 45, 60]) { pen.beginPath(); pen.arc(r, r, tilt * scale, 0, 7); pen.stroke(); }
  spot(next.tilt_deg, next.towards_deg, WANTED);
  if (pose) spot(Math.min(pose.tilt_deg, 60), pose.towards_deg, NOW);
}

function depths({ depth_m, pose }) {
  const canvas = at("depths");
  // As wide as it is seen, so that its letters are as large as others.
  if (canvas.clientWidth) canvas.width = canvas.clientWidth;
  const pen = canvas.getContext("2d"), far = 4, x = (depth) => 8 + (Math.min(depth, far) / far) * (canvas.width - 16);
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.fillStyle = EMPTY; pen.fillRect(8, 24, canvas.width - 16, 12);
  if (depth_m) { pen.fillStyle = DONE; pen.fillRect(x(depth_m[0]), 24, Math.max(4, x(depth_m[1]) - x(depth_m[0])), 12); }
  if (pose) { pen.fillStyle = NOW; pen.fillRect(x(pose.depth_m) - 2, 16, 4, 28); }
  pen.fillStyle = "#888"; pen.font = "12px system-ui";
  pen.fillText("0", 4, 56); pen.fillText(`${far} m`, canvas.width - 28, 56);
}
