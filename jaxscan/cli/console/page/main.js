// The page: shows what the server says, and passes orders on. It drives nothing by itself.
import { at, fill, make, ownName, refusal } from "/shared.js";
import { showLive, showPicture } from "/picture.js";
import { showGuide } from "/board.js";
import { Cloud } from "/cloud.js";
import { showCaptures } from "/captures.js";
import { showCalibration, showVerdict } from "/calibration.js";
import { showHand, takeHand } from "/exposure.js";
import { nextStep, resumable } from "/next_step.js";

const PICTURE = 1, CLOUD = 2;
const WORDS = { nothing: "ready", opening: "opening the rig …", aim: "looking", sweep: "scanning", boards: "capturing the board", placing: "place the board" };
const LASER = { off: "laser off", unknown: "laser not known to be off: switch its supply off" };
const cloud = new Cloud(at("cloud"), at("no-webgl"), at("points"), at("no-points"));
let socket = null, state = {}, you = { operates: false, pages: 0 }, again = 0;

function order(what, fields = {}) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ do: what, ...fields }));
  else say("problem", "No connection to the console: nothing was done.");
}

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { again = 0; at("lost").hidden = true; cloud.clear(0); socket.send(JSON.stringify({ page: ownName() })); };
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : look(data));
  socket.onclose = async ({ reason }) => {
    at("lost").hidden = false;
    if (reason) say("problem", reason);
    const why = await refusal();
    if (why) say("problem", why);
    setTimeout(connect, Math.min(300 * 2 ** again++, 5000));
  };
}

function hear(message) {
  if (message.kind === "refused") return say("problem", message.says);
  if (message.kind === "state") { state = message.state; you = message.you; show(); }
}

function look(data) {
  const kind = new Uint8Array(data, 0, 1)[0];
  if (kind === PICTURE) showPicture(new Blob([data.slice(1)], { type: "image/jpeg" }), state);
  if (kind === CLOUD) cloud.add(new DataView(data).getUint32(4, true), data.slice(8));
}

function say(id, text) { at(id).textContent = text ?? ""; at(id).hidden = !text; }

function duration(seconds) {
  if (seconds < 90) return `${Math.ceil(seconds)} s`;
  if (seconds < 600) return `${Math.round(seconds / 30) / 2} min`;
  const minutes = Math.ceil(seconds / 60);
  return minutes < 90 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

const size = (bytes) => (bytes >= 1e9 ? `${(bytes / 1e9).toFixed(1)} GB` : `${(bytes / 1e6).toFixed(1)} MB`);

// A capture is not written over: a name that is taken gives way to the next one, but not under a person's hands.
function nameAnew(id) {
  const field = at(id), [, stem, number] = field.value.match(/^(.*?)(?:-(\d+))?$/);
  const taken = (name) => state.captures.some((one) => one.name === name) || (state.doing !== "nothing" && state.order?.name === name);
  if (document.activeElement === field || !taken(field.value)) return;
  let next = Number(number ?? 1) + 1;
  while (taken(`${stem}-${next}`)) next++;
  field.value = `${stem}-${next}`;
}

function show() {
  const busy = state.doing !== "nothing", running = busy && state.doing !== "aim", operates = you.operates;
  at("config").textContent = state.config;
  at("doing").textContent = state.silence || (WORDS[state.doing] ?? state.doing);
  at("doing").classList.toggle("on", Boolean(state.silence));
  at("laser").textContent = LASER[state.laser] ?? "laser may shine";
  at("laser").classList.toggle("on", state.laser !== "off");
  at("role").textContent = operates ? (you.pages > 1 ? `you operate, ${you.pages - 1} watching` : "") : "watching";
  at("take-over").hidden = operates;
  say("problem", state.problem);
  say("ended", state.ended);
  const [step, goes] = nextStep(state, you.operates);
  at("next").textContent = step;
  for (const button of document.querySelectorAll("button.go")) if (!button.closest("#captures")) button.classList.remove("go");
  if (typeof goes === "string" && goes) at(goes).classList.add("go");
  at("estop").hidden = !state.estop;
  at("estop").textContent = `The emergency stop is pressed. Release it, then ${resumable(state) ? "press Resume" : "begin again"}.`;
  for (const id of ["aim", "boards", "sweep"]) at(id).disabled = !operates || running || (id === "aim" && busy);
  at("boards").disabled ||= !state.has_board;
  at("boards").title = state.has_board ? "" : "The configuration has no [board] table.";
  at("pause").disabled = !operates || !busy;
  at("pause").textContent = state.doing === "aim" ? "End" : "Pause";
  at("resume").disabled = !operates || busy || !resumable(state);
  for (const id of ["boards-name", "sweep-name"]) nameAnew(id);
  at("lost-stops").disabled = !operates;
  at("lost-stops").checked = state.lost === "stop";
  if (state.planned) {
    at("progress").max = state.planned;
    at("progress").value = state.done;
    at("count").textContent = `${state.capture}: ${state.done} of ${state.planned} records`;
    at("left").textContent = state.done < state.planned && state.left_s !== null ? `about ${duration(state.left_s)} left` : "";
  }
  const needs = running && state.needed_bytes ? `, this capture takes up to ${size(state.needed_bytes)}` : "";
  at("disk").textContent = state.free_bytes === undefined ? "" : `${size(state.free_bytes)} free on the disk${needs}`;
  const retakes = state.lines.filter((line) => line.kind === "retake");
  at("retakes").textContent = retakes.length ? `${retakes.length} taken again; why is written below` : "";
  fill(at("lines"), state.lines.slice(-60).reverse().map((line) => {
    const time = new Date(1000 * line.at).toLocaleTimeString();
    return make("li", `${time}  ${line.says}`, line.kind);
  }));
  at("folder").textContent = state.folder;
  showCalibration(state, operates);
  showLive(state);
  showHand(state, operates);
  showGuide(state);
  showVerdict(state);
  showCaptures(state, you.operates, cloud, order, typeof goes === "string" ? ["", ""] : goes);
  showWorks(state.works);
}

function showWorks(works) {
  at("calculations").hidden = !works.length;
  fill(at("works"), works.map((work) => {
    const how = work.running ? "…" : work.well ? "done" : "did not succeed";
    const item = make("li", `${work.what}: ${how}`, work.well === false ? "wrong" : "");
    if (work.lines.length && (work.running || !work.well || work.what.startsWith("compare"))) item.append(make("pre", work.lines.slice(-12).join("\n")));
    return item;
  }));
}

const named = (id) => ({ name: at(id).value, resume: false });
at("stop").onclick = () => order("stop");
at("aim").onclick = () => order("aim");
at("pause").onclick = () => order("pause");
at("take-over").onclick = () => order("take over");
at("take").onclick = () => order("take");
at("enough").onclick = () => order("enough");
at("enough-of-all").onclick = () => order("enough of all");
at("resume").onclick = () => order(state.order.do, { name: state.order.name, resume: true });
at("lost-stops").onchange = (event) => order("lost", { stop: event.target.checked });
at("calibrations").onchange = (event) => { order("use", { name: event.target.value }); event.target.blur(); };
takeHand(order);
// One panel at a time is as large as the page; the button that made it large makes it small again.
for (const button of document.querySelectorAll(".enlarge")) {
  button.onclick = () => {
    const panel = button.closest(".panel"), large = !panel.classList.contains("large");
    for (const one of document.querySelectorAll(".panel")) one.classList.toggle("large", one === panel && large);
    for (const one of document.querySelectorAll(".enlarge")) { one.textContent = one === button && large ? "make small" : "enlarge"; one.setAttribute("aria-pressed", one === button && large); }
  };
}
at("boards-form").onsubmit = (event) => { event.preventDefault(); order("boards", named("boards-name")); };
at("sweep-form").onsubmit = (event) => { event.preventDefault(); order("sweep", named("sweep-name")); };
addEventListener("keydown", (event) => {
  if (event.key === "Escape") order("stop");
  const writes = event.target.matches("input, button, canvas");
  if (event.key === " " && !writes && state.doing === "placing") { event.preventDefault(); order("take"); }
});
connect();
