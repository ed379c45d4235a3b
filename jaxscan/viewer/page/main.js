// The page: the server knows the points and measures; what is shown is chosen here.
import { Box } from "./box.js";
import { Camera } from "./camera.js";
import { Drawing } from "./draw.js";
import { drawMarks } from "./marks.js";
import { at, make, showProducts, showScale, showState } from "./panel.js";

const canvas = at("cloud"), camera = new Camera(), CLICK_PX = 8, STILL_PX = 5, FAR_M = 1000;
let state = { kind: "point", message: "", measured: [], first: null }, socket = null, again = 0, box = null, held = -1;
const placed = (one) => one.xyz.map((x, k) => x + (drawing.clouds[one.cloud]?.shift[k] ?? 0));
const drawing = new Drawing(canvas, camera, (panorama) => {
  const shows = box && at("section").checked && !panorama;
  drawMarks(at("marks"), camera, state, placed, shows ? (pen, width, height) => box.draw(pen, camera, width, height, held) : null);
  at("loading").hidden = drawing.points > 0 || panorama !== null;
  at("shown").textContent = panorama ? "a panorama is shown" : `${drawing.points.toLocaleString("en")} points shown`;
});

// Kept over a reload, so that its measurements are the same ones afterwards.
function ownName() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  const name = sessionStorage.getItem("page") ?? Array.from(bytes, (b) => b.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem("page", name);
  return name;
}

function connect() {
  const address = new URL(`socket?page=${ownName()}`, location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(address);
  socket.onopen = () => { again = 0; };
  socket.onmessage = ({ data }) => hear(JSON.parse(data));
  socket.onclose = () => {
    at("message").textContent = "No connection to jaxscan view; trying again …";
    setTimeout(connect, Math.min(300 * 2 ** again++, 5000));
  };
}

function hear(message) {
  if (message.file) return save(message);
  state = { ...state, ...message };
  showState(state);
  drawing.later();
}

function order(what) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(what));
  else at("message").textContent = "No connection to jaxscan view: nothing was done.";
}

function save({ file, text }) {
  const link = make("a");
  link.href = URL.createObjectURL(new Blob([text]));
  link.download = file;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const shown = () => ({
  clouds: drawing.clouds.filter((cloud) => cloud.visible).map(({ number, shift }) => ({ number, shift })),
  section: at("section").checked ? box.corners() : null,
});

function pick(x, y) {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  at("message").textContent = "measuring …";
  order({ do: "pick", ...camera.ray(x, y, width, height), cone_rad: Math.atan(CLICK_PX / camera.focal(height)), ...shown() });
}

async function colour() {
  const by = at("by").value, planes = state.measured.flatMap((one, k) => (one.plane ? [k] : []));
  const query = new URLSearchParams({ by, page: ownName(), plane: planes.at(-1) ?? "" }).toString();
  const problem = await showScale(query);
  if (problem) { at("message").textContent = problem; at("by").value = "photograph"; return; }
  drawing.recolour(query);
}

function bounds() {
  const some = drawing.clouds.filter((cloud) => cloud.visible), of = some.length ? some : drawing.clouds;
  const low = [0, 1, 2].map((k) => Math.min(...of.map((cloud) => cloud.low[k] + cloud.shift[k])));
  return [low, [0, 1, 2].map((k) => Math.max(...of.map((cloud) => cloud.high[k] + cloud.shift[k])))];
}

function apart() {
  let place = 0;
  for (const cloud of drawing.clouds) {
    cloud.shift = at("apart").checked ? [place - cloud.low[0] + drawing.clouds[0].low[0], 0, 0] : [...cloud.home];
    if (cloud.visible) place += 1.2 * (cloud.high[0] - cloud.low[0]);
  }
  enclose();
  look("outside");
}

// A section around all that is shown.
function enclose() {
  box = new Box(...bounds(), cut);
  cut();
}

function cut() {
  drawing.section = at("section").checked ? box.corners() : null;
  drawing.moved();
}

function look(where) {
  if (typeof where === "string") camera.stand(...bounds(), where === "above");
  else {
    drawing.standing = { cloud: where.cloud, place: where.xyz.map((x, k) => x + where.cloud.shift[k]) };
    camera.enter(drawing.standing.place);
  }
  drawing.moved();
}

// The side of the section whose handle a pointer is on; -1 if on none.
function grasped(event) {
  if (!box || !at("section").checked || drawing.around()) return -1;
  return box.handleAt(event.offsetX, event.offsetY, camera, canvas.clientWidth, canvas.clientHeight, event.pointerType === "touch");
}

// Hands: one finger or the left button turns, two fingers or another button move, a tap measures; handles are dragged.
const fingers = new Map();
let travelled = 0, spread = 0;
canvas.oncontextmenu = (event) => event.preventDefault();
canvas.onpointerdown = (event) => {
  canvas.setPointerCapture(event.pointerId);
  if (!fingers.size) { travelled = 0; held = grasped(event); }
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  if (fingers.size > 1) { travelled = STILL_PX + 1; held = -1; }
  spread = 0;
};
canvas.onpointermove = (event) => {
  const before = fingers.get(event.pointerId);
  if (!before) { canvas.style.cursor = grasped(event) < 0 ? "" : "grab"; return; }
  const dx = event.clientX - before[0], dy = event.clientY - before[1];
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  travelled += Math.hypot(dx, dy);
  if (held >= 0) return box.drag(held, dx, dy, camera, canvas.clientWidth, canvas.clientHeight);
  if (travelled <= STILL_PX) return;
  if (fingers.size > 1) {
    const [a, b] = [...fingers.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (spread) camera.zoom(spread / now);
    spread = now;
    camera.move(dx / canvas.clientHeight / 2, dy / canvas.clientHeight / 2);
  } else if (event.shiftKey || event.buttons > 1) camera.move(dx / canvas.clientHeight, dy / canvas.clientHeight);
  else camera.turn(dx / 200, dy / 200);
  drawing.moved();
};
canvas.onpointerup = (event) => {
  fingers.delete(event.pointerId);
  if (held >= 0) { held = -1; drawing.later(); } else if (travelled <= STILL_PX && event.button === 0) pick(event.offsetX, event.offsetY);
};
canvas.onpointercancel = (event) => { fingers.delete(event.pointerId); held = -1; };
canvas.addEventListener("wheel", (event) => { event.preventDefault(); camera.zoom(Math.exp(event.deltaY / 600)); drawing.moved(); }, { passive: false });
canvas.ondblclick = () => { const last = state.measured.at(-1); if (last?.at.length) { camera.target = placed(last.at.at(-1)); drawing.moved(); } };

const KEYS = {
  p: () => order({ do: "choose", what: "point" }), d: () => order({ do: "choose", what: "distance" }), f: () => order({ do: "choose", what: "flatness" }),
  u: () => order({ do: "undo" }), o: () => look("outside"), a: () => look("above"), s: () => at("station-1")?.click(),
  "+": () => camera.zoom(0.85), "-": () => camera.zoom(1.18), Enter: () => pick(canvas.clientWidth / 2, canvas.clientHeight / 2),
  ArrowLeft: () => camera.turn(-0.08, 0), ArrowRight: () => camera.turn(0.08, 0), ArrowUp: () => camera.turn(0, 0.08), ArrowDown: () => camera.turn(0, -0.08),
};
addEventListener("keydown", (event) => {
  const work = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!work || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input, select, button, summary")) return;
  event.preventDefault(); work(); drawing.moved();
});

for (const kind of ["point", "distance", "flatness"]) at(kind).onclick = () => order({ do: "choose", what: kind });
at("undo").onclick = () => order({ do: "undo" });
at("room").onclick = () => { at("message").textContent = "measuring …"; order({ do: "room", ...shown() }); };
for (const what of ["csv", "json"]) at(what).onclick = () => order({ do: "save", what });
for (const where of ["outside", "above"]) at(where).onclick = () => look(where);
at("by").onchange = colour;
at("photographs").onchange = () => { drawing.photographs = at("photographs").checked; drawing.moved(); };
at("apart").onchange = apart;
at("section").onchange = cut;
at("budget").oninput = () => { drawing.budget = 1e6 * at("budget").value; drawing.later(); };
at("size").oninput = () => { drawing.size = Number(at("size").value); drawing.moved(); };

async function begin() {
  at("no-webgl").hidden = Boolean(drawing.gl);
  if (!drawing.gl) at("loading").hidden = true;
  const answer = await fetch("scene");
  if (!answer.ok) { at("loading").textContent = await answer.text(); at("panel").hidden = true; return; }
  const scene = await answer.json();
  drawing.clouds = scene.clouds.map((cloud, number) => ({ ...cloud, number, visible: true, home: cloud.shift }));
  // Too far apart for one scene: they stand side by side, always.
  if (drawing.clouds.some((cloud) => Math.hypot(...cloud.home) > FAR_M)) { at("apart").checked = true; at("apart").disabled = true; }
  at("systematic").hidden = scene.systematic;
  at("by").replaceChildren(...scene.colourings.map((by) => { const option = make("option", by); option.value = by; return option; }));
  let stations = 0;
  for (const cloud of drawing.clouds) {
    for (const xyz of cloud.stations) {
      const button = make("button", `station ${++stations}`);
      button.id = `station-${stations}`;
      button.onclick = () => look({ xyz, cloud });
      at("places").append(button);
    }
  }
  at("photographs-part").hidden = !drawing.clouds.some((cloud) => cloud.panorama);
  at("products-part").hidden = !scene.products;
  at("products-part").ontoggle = () => { if (at("products-part").open) showProducts(); };
  at("look-again").onclick = showProducts;
  at("clouds-part").hidden = drawing.clouds.length < 2;
  for (const cloud of drawing.clouds) {
    const label = make("label"), tick = make("input");
    Object.assign(tick, { type: "checkbox", checked: true, onchange: () => { cloud.visible = tick.checked; if (at("apart").checked) apart(); drawing.moved(); } });
    label.append(tick, ` ${cloud.name}`);
    at("clouds").append(label);
  }
  if (at("apart").checked) apart();
  drawing.query = "by=photograph";
  enclose();
  look("outside");
  connect();
}
begin();
