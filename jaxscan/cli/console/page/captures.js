// What is on the disk: to open, to reconstruct, to compare.
import { at, fill, make } from "/shared.js";

const MADE = { plan: "Plan (PDF)", mesh: "Mesh (GLB)", report: "Report (HTML)" }, MAKE = { plan: "Plan", mesh: "Mesh", report: "Report" };
let order = () => {}, opened = null, chosen = null, shown = "";
// What is asked once more before it is done: [what, capture].
let asked = ["", ""];

// Whether the cloud of a capture is not that of the calibration that is used, and of which one it is, if that is known.
export const isOld = (capture, state) => Boolean(capture.cloud && capture.made_with && state.calibration_digest && capture.made_with !== state.calibration_digest);
export const maker = (capture, state) => (state.calibrations ?? []).find((one) => one.digest === capture.made_with);

// `goes` is [capture, button]: the one that is the next step.
export function showCaptures(state, operates, cloud, send, goes = ["", ""]) {
  order = send;
  const going = state.doing === "nothing" ? "" : `${state.capture} ${state.done}`;
  const busy = state.works.some((work) => work.running);
  const key = JSON.stringify([state.captures, operates, state.calibration, state.calibration_digest, chosen, asked, state.doing, going, busy, goes]);
  if (key === shown) return;
  // Not under a person's hands.
  if (at("captures").contains(document.activeElement) && document.activeElement.matches("input")) return;
  shown = key;
  fill(at("captures"), state.captures.map((capture) => card(capture, state, operates, cloud, goes)));
  const begun = state.doing === "sweep" || state.doing === "boards" || state.doing === "placing";
  if (begun && state.planned && !state.captures.some((one) => one.name === state.capture)) {
    const item = make("li");
    item.append(make("strong", state.capture), make("div", words({ name: state.capture }, state), "quiet"));
    at("captures").prepend(item);
  } else if (!state.captures.length) at("captures").append(make("li", "nothing captured yet", "quiet"));
}

function words(capture, state) {
  // The list is read anew when a session ends; until then its own count is newer.
  if (state.doing !== "nothing" && state.doing !== "aim" && capture.name === state.capture) return `${state.done} of ${state.planned} records, going on`;
  return `${capture.kind}, ${capture.records} ${capture.records === 1 ? "record" : "records"}${capture.complete ? "" : ", not complete"}`;
}

function card(capture, state, operates, cloud, goes) {
  const item = make("li"), path = `/pictures/${encodeURIComponent(capture.name)}`;
  if (capture.records) {
    const image = make("img");
    image.src = `${path}/${Math.floor(capture.records / 2)}?small=1&lit=1&changed=${capture.changed}`;
    image.alt = `A record of ${capture.name}`;
    image.loading = "lazy";
    item.append(image);
  }
  item.append(make("strong", capture.name), make("div", capture.problem || words(capture, state), capture.problem ? "wrong" : "quiet"));
  if (isOld(capture, state)) item.append(make("div", `its cloud is of ${maker(capture, state)?.file ?? "another calibration"}`, "quiet"));
  const again = () => showCaptures(state, operates, cloud, order, goes), free = operates && state.doing === "nothing" && !state.works.some((work) => work.running);
  const button = (text, work, enabled = true, why = "") => {
    const made = make("button", text);
    made.disabled = !enabled;
    if (why) made.title = why;
    if (goes[0] === capture.name && goes[1] === text) made.classList.add("go");
    made.onclick = work;
    item.append(made);
    return made;
  };
  if (asked[1] === capture.name) return ask(item, capture, button, again);
  if (capture.records) button("Open", () => open(capture));
  if (capture.kind === "calibration") button("Calibrate", () => order("calibrate", { name: capture.name }), operates);
  if (capture.kind === "sweep") button("Reconstruct", () => order("reconstruct", { name: capture.name }), operates && Boolean(state.calibration), state.calibration ? "" : "It needs a calibration: capture the board first.");
  if (capture.cloud) button("Show cloud", () => showCloud(capture.name, cloud));
  if (capture.cloud) button("Look around", () => window.open(`/look/${encodeURIComponent(capture.name)}/`, "_blank", "noopener"));
  const several = state.captures.filter((one) => one.cloud).length > 1;
  if (capture.cloud && chosen === capture.name) button("Do not compare", () => { chosen = null; showCaptures(state, operates, cloud, order); });
  else if (capture.cloud && several) button(chosen ? `Compare with ${chosen}` : "Compare …", () => compare(capture.name, state, operates, cloud), operates);
  if (capture.kind === "sweep" && state.calibration && capture.records) button("Recalibrate", () => order("recalibrate", { name: capture.name }), operates, "betters the calibration by this room");
  for (const what of Object.keys(MAKE)) {
    if (!capture.cloud) break;
    if (capture.made?.includes(what)) item.append(kept(capture.name, what));
    else button(MAKE[what], () => order(what, { name: capture.name }), operates);
  }
  if (capture.kind && !capture.complete && operates && state.doing === "nothing") {
    button("Go on", () => order(capture.kind === "sweep" ? "sweep" : "boards", { name: capture.name, resume: true }));
  }
  button("Rename …", () => { asked = ["rename", capture.name]; again(); }, free);
  button("Delete …", () => { asked = ["delete", capture.name]; again(); }, free);
  return item;
}

// A link to what was made, to be kept.
function kept(name, what) {
  const link = make("a", MADE[what], "made");
  link.href = `/made/${encodeURIComponent(name)}/${what}`;
  link.download = "";
  return link;
}

function ask(item, capture, button, again) {
  const done = (work) => () => { asked = ["", ""]; work(); again(); };
  if (asked[0] === "delete") {
    item.append(make("p", `Delete ${capture.name} with its ${capture.records} records, its cloud, and what was made of it? Calibrations stay. It cannot be taken back.`, "wrong"));
    button("Delete for good", done(() => order("delete", { name: capture.name }))).classList.add("danger");
  } else {
    const field = make("input");
    Object.assign(field, { value: capture.name, maxLength: 64, pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]*" });
    field.setAttribute("aria-label", `New name of ${capture.name}`);
    item.append(field);
    const rename = () => { if (!field.reportValidity() || field.value === capture.name) return; field.blur(); done(() => order("rename", { name: capture.name, other: field.value }))(); };
    field.onkeydown = ({ key }) => { if (key === "Enter") rename(); };
    button("Rename", rename);
  }
  button("Keep it", done(() => {}));
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
