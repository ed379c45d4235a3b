// The page: shows what the server says, and passes orders on. It drives nothing by itself.
import { at, fill, make, ownName, refusal } from "/shared.js";
import { showLive, showPicture } from "/live.js";
import { showGuide } from "/guide.js";
import { Cloud } from "/cloud.js";
import { isOld, maker, showCaptures } from "/captures.js";
import { showHand, takeHand } from "/hand.js";

const PICTURE = 1, CLOUD = 2;
const WORDS = { nothing: "ready", opening: "opening the rig …", aim: "looking", sweep: "scanning", boards: "capturing the board", placing: "place the board" };
const WAITS = {
  calibrate: "The calibration is calculated: wait for its verdict.", recalibrate: "The calibration is bettered: wait for its verdict.",
  reconstruct: "The cloud is calculated; it can be looked at as soon as that is done.",
};
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

// What to do next: in words, and the one button for it, by its id or as [capture, button].
function next() {
  if (!you.operates) return ["", ""];
  if (state.doing === "placing") return ["", "take"];
  if (state.doing === "aim") {
    const { exposure, proof } = state.live ?? {};
    if (proof || !exposure) return ["", ""];
    if (exposure.do.startsWith("expose")) return ["Press Auto: it finds the exposure for what is seen now.", "auto"];
    const well = exposure.do ? `Better: ${exposure.do}. Then` : "The line is good:";
    return state.calibration || !state.has_board ? [`${well} Scan.`, "sweep"] : [`${well} Calibrate, with the board.`, "boards"];
  }
  if (state.doing !== "nothing") return ["", ""];
  const work = state.works.find((work) => work.running), waits = WAITS[work?.what.split(" ")[0]];
  if (waits) return [`${waits} ${work.lines.at(-1)?.match(/about .* left$/)?.[0] ?? ""}`, ""];
  if (resumable()) return [`Resume goes on with ${state.order.name}.`, "resume"];
  const made = state.captures.find((capture) => capture.cloud);
  const before = made && isOld(made, state) && maker(made, state), used = inUse();
  if (before?.sigma_mm < used?.sigma_mm) return [`${used.file} is used now: ${twoDigits(used.sigma_mm)} mm. ${before.file}, with which ${made.name} was made, is good to ${twoDigits(before.sigma_mm)} mm: if the rig is as it was, choose it under Calibration. If not, Scan.`, "sweep"];
  if (made && isOld(made, state)) return [`Reconstruct ${made.name} again: its cloud was made with another calibration than the one that is used now.`, [made.name, "Reconstruct"]];
  const better = made && state.calibration && !(state.verdict?.of ?? []).includes(made.name) ? " Recalibrate betters the calibration by it." : "";
  if (made) return [`${made.name} has its cloud: Look around, under Captures, or Scan again.${better}`, [made.name, "Look around"]];
  if (!state.calibration && state.verdict?.verdict) return ["This calibration is not used: its verdict below says what to do.", "boards"];
  if (!state.calibration) return [`First Look, until the line is bright and sharp; then ${state.has_board ? "Calibrate, with the board" : "Scan"}.`, !state.live ? "aim" : state.has_board ? "boards" : "sweep"];
  const swept = state.captures.find((capture) => capture.kind === "sweep" && capture.complete);
  if (swept) return [`Reconstruct ${swept.name}, under Captures, makes its cloud.`, [swept.name, "Reconstruct"]];
  return ["Take the board out of the room; then Scan.", "sweep"];
}

const resumable = () => Boolean(state.order) && state.order.do !== "aim" && state.done < state.planned && known(state.order.name) && !known(state.order.name).complete;
const known = (name) => state.captures.find((capture) => capture.name === name);

// A capture is not written over: a name that is taken gives way to the next one, but not under a person's hands.
function nameAnew(id) {
  const field = at(id), [, stem, number] = field.value.match(/^(.*?)(?:-(\d+))?$/);
  const taken = (name) => known(name) || (state.doing !== "nothing" && state.order?.name === name);
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
  const [step, goes] = next();
  at("next").textContent = step;
  for (const button of document.querySelectorAll("button.go")) if (!button.closest("#captures")) button.classList.remove("go");
  if (typeof goes === "string" && goes) at(goes).classList.add("go");
  at("estop").hidden = !state.estop;
  at("estop").textContent = `The emergency stop is pressed. Release it, then ${resumable() ? "press Resume" : "begin again"}.`;
  for (const id of ["aim", "boards", "sweep"]) at(id).disabled = !operates || running || (id === "aim" && busy);
  at("boards").disabled ||= !state.has_board;
  at("boards").title = state.has_board ? "" : "The configuration has no [board] table.";
  at("pause").disabled = !operates || !busy;
  at("pause").textContent = state.doing === "aim" ? "End" : "Pause";
  at("resume").disabled = !operates || busy || !resumable();
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
  showCalibration();
  showLive(state);
  showHand(state, operates);
  showGuide(state);
  showVerdict(state.verdict);
  showCaptures(state, you.operates, cloud, order, typeof goes === "string" ? ["", ""] : goes);
  showWorks(state.works);
}

function age(seconds) {
  const [each, name] = [[86400, "day"], [3600, "hour"], [60, "minute"]].find(([each]) => seconds >= each) ?? [1, ""];
  const count = Math.floor(seconds / each);
  return name ? `${count} ${name}${count === 1 ? "" : "s"} ago` : "just now";
}

// By the user's own goal; a colour without one would judge what nobody asked for.
const judged = (size) => (!state.goal_mm || !size ? "" : size <= state.goal_mm ? "good" : "open");

const inUse = () => (state.calibrations ?? []).find((one) => state.calibration && state.calibration.split("/").at(-1) === one.file);

// The calibration that is used, and those that may be used instead. Its verdict is said once.
function showCalibration() {
  const known = state.calibrations ?? [], used = inUse();
  const made = used ? age(Date.now() / 1000 - used.changed) : "", below = used && state.verdict?.verdict?.headline === used.headline;
  at("calibration").textContent = !state.calibration ? "none yet: the cloud grows once there is one" : !used ? state.calibration : below ? `made ${made}` : `${used.headline}; ${made}`;
  at("calibration").className = used && !below ? judged(used.sigma_mm) : "";
  const some = known.filter((one) => one.good), list = at("calibrations");
  list.hidden = !some.length;
  list.disabled = !you.operates;
  const words = (one) => [one.sigma_mm && `${twoDigits(one.sigma_mm)} mm`, one.file, age(Date.now() / 1000 - one.changed)].filter(Boolean).join(", ");
  const key = JSON.stringify([some.map(words), used?.file]);
  if (list.dataset.shown === key || document.activeElement === list) return;
  list.dataset.shown = key;
  fill(list, [...(used?.good ? [] : [make("option", state.calibration ?? "choose one")]), ...some.map((one) => { const made = make("option", words(one)); made.value = one.file; return made; })]);
  list.value = used?.file ?? list.options[0]?.value;
}

function showVerdict(verdict) {
  at("verdict").hidden = !verdict?.verdict;
  if (!verdict?.verdict) return;
  const own = judged(verdict.sigma_mm), kinds = { good: own, plain: own, bad: "wrong", open: "open" };
  at("headline").textContent = `${verdict.so_far ? `${verdict.so_far} so far: ` : ""}${verdict.verdict.headline}`;
  at("headline").className = `headline ${kinds[verdict.verdict.kind] ?? ""}`;
  at("goal").textContent = !verdict.sigma_mm ? "" : state.goal_mm ? `Your goal_mm is ${state.goal_mm}: ${verdict.sigma_mm <= state.goal_mm ? "met" : "not met"}.` : `Write goal_mm into ${state.config} to have it judged.`;
  at("explanation").textContent = verdict.verdict.explanation;
  fill(at("lengths"), (verdict.lengths ?? []).map((length) => {
    const row = make("tr", undefined, length.part ? "part" : "");
    row.append(make("td", `± ${twoDigits(length.sigma_mm)} mm`), make("td", length.what));
    return row;
  }));
  fill(at("next-steps"), [...(verdict.warnings ?? []), ...(verdict.advice ?? [])].map((text) => make("li", text)));
}

const twoDigits = (size) => (size >= 10 ? size.toFixed(0) : Number(size.toPrecision(2)).toString());

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
