// What is on the disk: to open, to reconstruct, to compare.
import { at, fill, make } from "/dom.js";

let order = () => {}, opened = null, chosen = null, shown = "";

export function showCaptures(state, operates, cloud, send) {
  order = send;
  const key = JSON.stringify([state.captures, operates, state.calibration, chosen, state.doing === "nothing"]);
  if (key === shown) return;
  shown = key;
  fill(at("captures"), state.captures.map((capture) => card(capture, state, operates, cloud)));
  if (!state.captures.length) at("captures").append(make("li", "nothing captured yet", "quiet"));
}

function card(capture, state, operates, cloud) {
  const item = make("li"), path = `/pictures/${encodeURIComponent(capture.name)}`;
  if (capture.records) {
    const image = make("img");
    image.src = `${path}/${Math.floor(capture.records / 2)}?small=1&lit=1&changed=${capture.changed}`;
    image.alt = `A record of ${capture.name}`;
    image.loading = "lazy";
    item.append(image);
  }
  item.append(make("strong", capture.name), make("div", capture.problem || `${capture.kind}, ${capture.records} records${capture.complete ? "" : ", not complete"}`, capture.problem ? "wrong" : "quiet"));
  const button = (text, work, enabled = true) => {
    const made = make("button", text);
    made.disabled = !enabled;
    made.onclick = work;
    item.append(made);
  };
  if (capture.records) button("Open", () => open(capture));
  if (capture.kind === "calibration") button("Calibrate", () => order("calibrate", { name: capture.name }), operates);
  if (capture.kind === "sweep") button("Reconstruct", () => order("reconstruct", { name: capture.name }), operates && Boolean(state.calibration));
  if (capture.cloud) button("Show cloud", () => showCloud(capture.name, cloud));
  if (capture.cloud) button("Look around", () => window.open(`/look/${encodeURIComponent(capture.name)}/`, "_blank", "noopener"));
  const several = state.captures.filter((one) => one.cloud).length > 1;
  if (capture.cloud && chosen === capture.name) button("Do not compare", () => { chosen = null; showCaptures(state, operates, cloud, order); });
  else if (capture.cloud && several) button(chosen ? `Compare with ${chosen}` : "Compare …", () => compare(capture.name, state, operates, cloud), operates);
  if (capture.kind && !capture.complete && operates && state.doing === "nothing") {
    button("Go on", () => order(capture.kind === "sweep" ? "sweep" : "boards", { name: capture.name, resume: true }));
  }
  return item;
}

function compare(name, state, operates, cloud) {
  if (chosen) order("compare", { name, other: chosen });
  chosen = chosen ? null : name;
  showCaptures(state, operates, cloud, order);
}

async function showCloud(name, cloud) {
  const answer = await fetch(`/clouds/${encodeURIComponent(name)}`);
  if (!answer.ok) return;
  cloud.clear(-1);
  cloud.add(-1, await answer.arrayBuffer());
  at("cloud").scrollIntoView({ block: "nearest" });
}

function open(capture) {
  opened = capture;
  at("opened").hidden = false;
  at("records").max = capture.records - 1;
  at("records").value = 0;
  turn();
  at("opened").scrollIntoView({ block: "nearest" });
}

function turn() {
  const index = Number(at("records").value);
  at("record").src = `/pictures/${encodeURIComponent(opened.name)}/${index}${at("lit").checked ? "?lit=1" : ""}`;
  at("record-name").textContent = `${opened.name}, ${index + 1} of ${opened.records}`;
}

at("close").onclick = () => { at("opened").hidden = true; };
at("records").oninput = turn;
at("lit").onchange = turn;
