import { at } from "/shared.js";
import { exposureNote } from "/exposure.js";

// The camera's picture, with the laser's line, the board's corners, and the place where to hold the board next.
const canvas = at("picture"), pen = canvas.getContext("2d");
let bitmap = null, known = {};

export async function showPicture(blob, state) {
  const next = await createImageBitmap(blob);
  bitmap?.close();
  bitmap = next;
  at("no-picture").hidden = true;
  draw(state);
}

export function showLive(state) {
  known = state;
  const live = state.live ?? {};
  const lit = live.peak_dn !== undefined;
  at("facts").hidden = !bitmap;
  at("peak").value = live.peak_dn ?? 0;
  at("peak-dn").textContent = lit ? `${live.peak_dn.toFixed(0)} of 255${live.clipped > 0.02 ? `, ${(100 * live.clipped).toFixed(0)} % clipped` : ""}` : "–";
  at("angle").textContent = live.angle_deg === undefined ? "" : `table at ${live.angle_deg.toFixed(2)}°`;
  const exposure = live.exposure, looks = state.doing === "aim";
  const said = live.proof || (exposure ? exposure.do && `${exposure.found}: ${exposure.do.startsWith("expose") ? "press Auto, or set it here" : exposure.do}` || `exposure is good: ${exposure.found}` : "");
  // Of a look that has ended nothing is advised.
  at("exposure").textContent = [looks ? said : "", exposureNote(state)].filter(Boolean).join(". ");
  if (!bitmap) at("no-picture").textContent = state.doing === "opening" ? "opening the rig …" : "Press Look to see what the camera sees.";
  draw(state);
}

function draw(state) {
  if (!bitmap) return;
  const live = (state.live ?? known.live) ?? { width: bitmap.width, height: bitmap.height, stripe: [] };
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) { canvas.width = bitmap.width; canvas.height = bitmap.height; }
  pen.drawImage(bitmap, 0, 0);
  const sx = canvas.width / live.width, sy = canvas.height / live.height;
  pen.fillStyle = "#19d36b";
  for (const [u, v] of live.stripe) pen.fillRect(u * sx - 1, v * sy - 1, 2.5, 2.5);
  const guide = state.placing ? state.guide : null;
  if (!guide) return;
  pen.fillStyle = "#ffb000";
  for (const [u, v] of guide.found) pen.fillRect(u * sx - 2, v * sy - 2, 4, 4);
  ghost(guide.next, state.board_aspect ?? 1.4);
}

// The outline of a board whose side `towards` is the nearer one, as a camera with a focal length of the picture's width sees it.
function ghost(next, aspect) {
  const height = 0.34 * canvas.height, width = aspect * height, focal = canvas.width;
  const tilt = (next.tilt_deg * Math.PI) / 180, towards = (next.towards_deg * Math.PI) / 180;
  const cx = Math.min(Math.max(next.at[0] * canvas.width, 0.6 * width), canvas.width - 0.6 * width);
  const cy = Math.min(Math.max(next.at[1] * canvas.height, 0.6 * height), canvas.height - 0.6 * height);
  pen.strokeStyle = "#4fb3ff"; pen.lineWidth = 3; pen.setLineDash([10, 6]);
  pen.beginPath();
  for (const [x, y] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
    const a = (x * width) / 2, b = (y * height) / 2;
    const along = a * Math.cos(towards) + b * Math.sin(towards), across = -a * Math.sin(towards) + b * Math.cos(towards);
    const depth = focal / (focal - along * Math.sin(tilt)), near = along * Math.cos(tilt);
    const u = (near * Math.cos(towards) - across * Math.sin(towards)) * depth, v = (near * Math.sin(towards) + across * Math.cos(towards)) * depth;
    pen.lineTo(cx + u, cy + v);
  }
  pen.closePath(); pen.stroke(); pen.setLineDash([]);
}
