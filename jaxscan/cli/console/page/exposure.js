// By hand while one looks: exposure, gain, the table's angle and the laser; and the histogram of what is seen.
import { at } from "/shared.js";

const BINS = 64;
let now = { exposure_ms: 10, gain_db: 0, angle_deg: 0 };

export function showHand(state, operates) {
  const { wish = {}, camera = {}, doing } = state, aims = doing === "aim", still = doing === "nothing" || aims;
  now = {
    exposure_ms: wish.exposure_ms ?? camera.exposure_ms ?? 10, gain_db: wish.gain_db ?? camera.gain_db ?? 0, angle_deg: wish.angle_deg ?? 0,
  };
  at("hand").hidden = !still;
  at("jog").hidden = !aims;
  for (const id of ["exposure-ms", "exposure-log", "gain-db"]) at(id).disabled = !operates || !still;
  for (const button of at("jog").querySelectorAll("button, input")) button.disabled = !operates || !aims;
  at("auto").disabled = !operates || !aims || wish.lit === false;
  at("auto").textContent = wish.auto ? "Auto …" : "Auto";
  // Not under a person's hands.
  const set = (id, value) => { if (document.activeElement !== at(id)) at(id).value = value; };
  set("exposure-ms", Number(now.exposure_ms.toPrecision(3)));
  set("exposure-log", Math.log10(now.exposure_ms));
  set("gain-db", now.gain_db);
  at("light").checked = wish.lit !== false;
  drawHistogram(state.live?.histogram);
}

// Levels by the logarithm of how many have them; the last ones, as bright as can be, are red.
function drawHistogram(counts) {
  const canvas = at("histogram"), pen = canvas.getContext("2d"), { width, height } = canvas;
  pen.clearRect(0, 0, width, height);
  if (!counts) return;
  const most = Math.log1p(Math.max(...counts));
  counts.forEach((count, bin) => {
    const tall = (height * Math.log1p(count)) / most;
    pen.fillStyle = bin === BINS - 1 ? "#e5534b" : "#7a8794";
    pen.fillRect((bin * width) / BINS, height - tall, width / BINS, tall);
  });
}

// What differs from the configuration, and how it is kept.
export function exposureNote({ wish, camera, config }) {
  const sameGain = wish?.gain_db === (camera?.gain_db ?? 0);
  if (!wish?.exposure_ms || (wish.exposure_ms === camera?.exposure_ms && sameGain)) return "";
  const gain = sameGain ? "" : ` and camera.gain_db = ${wish.gain_db}`;
  return `This exposure holds until the console ends; to keep it, write camera.exposure_ms = ${wish.exposure_ms}${gain} into ${config}.`;
}

export function takeHand(order) {
  const expose = (exposure_ms, gain_db) => { if (exposure_ms > 0 && Number.isFinite(gain_db)) order("expose", { exposure_ms, gain_db }); };
  at("exposure-ms").onchange = () => expose(Number(at("exposure-ms").value), now.gain_db);
  at("exposure-log").oninput = () => { at("exposure-ms").value = Number((10 ** Number(at("exposure-log").value)).toPrecision(2)); };
  at("exposure-log").onchange = () => expose(Number(at("exposure-ms").value), now.gain_db);
  at("gain-db").onchange = () => expose(now.exposure_ms, Number(at("gain-db").value));
  at("auto").onclick = () => order("auto");
  at("light").onchange = () => order("light", { on: at("light").checked });
  for (const button of at("jog").querySelectorAll("button")) {
    const deg = Number(button.dataset.deg);
    button.onclick = () => order("jog", { deg: deg ? now.angle_deg + deg : 0 });
  }
}
