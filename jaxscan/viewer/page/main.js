// The page: the server knows the points and measures; what is shown is chosen here.
import { showBearings, takePicture } from "./bearings.js";
import { Box } from "./box.js";
import { Camera, OUTSIDE } from "./camera.js";
import { Drawing, GAP as GAP_M, RADIUS, X } from "./draw.js";
import { takeHands } from "./hands.js";
import { drawMarks, showCross } from "./marks.js";
import { at, make, ownName, refusal } from "./shared.js";
import { say, sayWaiting, showProducts, showScale, showState, titles } from "./panel.js";

const canvas = at("cloud"), camera = new Camera(), CLICK_PX = 8, FAR_M = 1000, GAP = 1.1, AWAY = "No connection to jaxscan view";
let state = { kind: "point", message: "", measured: [], places: [], measuring: 0 }, socket = null, again = 0, box = null, scene = null;
// The quantity that the colours show, and the flatness that they are about.
let by = "", plane = "";
const several = () => drawing.clouds.length > 1, moved = (xyz, shift) => xyz.map((x, k) => x + shift[k]);
const placed = (one) => { const cloud = drawing.clouds[one.cloud]; return cloud?.visible ? moved(one.xyz, cloud.shift) : null; };
const sectioned = () => (box && at("section").checked && !drawing.around() ? box : null);
const drawing = new Drawing(canvas, camera, (panorama) => {
  if (!drawing.clouds.length) return;
  const section = sectioned(), none = !drawing.clouds.some((cloud) => cloud.visible);
  drawMarks(at("marks"), camera, {
    state, place: placed, box: section && ((pen, width, height) => section.draw(pen, camera, width, height)),
    names: at("apart").checked ? drawing.clouds.filter((cloud) => cloud.visible).map((cloud) => [cloud.title, top(cloud)]) : [],
  });
  showBearings(at("axes"), at("bar-of-scale"), camera, canvas.clientWidth, canvas.clientHeight);
  showCross(at("cross"), camera, canvas.matches(":focus-visible"), canvas.clientWidth, canvas.clientHeight);
  at("loading").hidden = (drawing.points > 0 || panorama !== null) && !none;
  at("loading").textContent = none ? "no cloud is shown" : "loading …";
  at("shown").textContent = panorama ? "a panorama is shown" : `${drawing.points.toLocaleString("en")} points shown`;
  at("caption").textContent = caption();
});

// Which clouds are shown, and of how many points.
function caption() {
  const seen = drawing.clouds.filter((cloud) => cloud.visible), points = seen.reduce((sum, cloud) => sum + cloud.points, 0);
  return seen.length ? `${seen.map((cloud) => cloud.title).join(", ")} · ${points.toLocaleString("en")} points` : "";
}

function connect() {
  const address = new URL(`socket?page=${ownName()}`, location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(address);
  socket.onopen = () => { again = 0; };
  socket.onmessage = ({ data }) => hear(JSON.parse(data));
  socket.onclose = async () => {
    say(`${AWAY}; trying again …`);
    const why = await refusal();
    if (why) say(`${AWAY}; trying again. ${why}`);
    setTimeout(connect, Math.min(300 * 2 ** again++, 5000));
  };
}

function hear(message) {
  if (message.file) return save(message);
  // The server began anew, perhaps with other clouds.
  if (message.scene && message.scene !== scene.id) return location.reload();
  state = { ...state, measuring: 0, ...message };
  showState(state, (one) => (several() ? drawing.clouds[one.cloud].title : ""), (id) => order({ do: "remove", id }));
  if (by === "deviation" && lastPlane() !== plane) {
    // Deviations from a plane that was taken back are none.
    if (lastPlane() === "") at("by").value = scene.colourings[0];
    colour();
  }
  drawing.marked();
}

function order(what) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(what));
  else say(`${AWAY}: nothing was done.`);
}

function measure(what) {
  state.measuring++; at("undo").disabled = false;
  sayWaiting("measuring …"); order({ ...what, ...shown() });
}

const save = ({ file, text }) => keep(file, new Blob([text]));
function keep(file, blob) {
  const link = make("a");
  link.href = URL.createObjectURL(blob);
  link.download = file;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const shown = () => ({
  clouds: drawing.clouds.filter((cloud) => cloud.visible).map(({ number, shift }) => ({ number, shift })),
  ...(at("section").checked ? box.cut() : {}), backs: drawing.backs, surface: drawing.joined,
});

async function savePicture() {
  const legend = at("scale").hidden ? null : { bar: at("bar"), words: at("scale-words").textContent };
  keep("view.png", await takePicture(canvas, at("marks"), camera, { caption: caption(), legend }));
}

// The points in the section as a file.
async function saveSection() {
  const answer = await fetch(`cut?${new URLSearchParams({ order: JSON.stringify({ do: "cut", ...shown(), ...box.cut() }) })}`).catch(() => null);
  if (answer?.ok) keep("section.ply", await answer.blob());
  else say(answer ? (await answer.text()).trim() : `${AWAY}: nothing was saved.`);
}

async function join() {
  say(at("surface").checked ? "joining the points …" : "");
  const problem = await drawing.join(at("surface").checked);
  if (problem) say(problem); else hear({ measuring: state.measuring });
}

function pick(x, y) {
  const size = [canvas.clientWidth, canvas.clientHeight];
  measure({ do: "pick", ...camera.ray(x, y, ...size), cone_rad: Math.atan(CLICK_PX / camera.focal(...size)) });
}

const lastPlane = () => state.measured.filter((one) => one.plane).at(-1)?.id ?? "";

async function colour() {
  const wanted = at("by").value, last = lastPlane();
  if (wanted === "deviation" && last === "") {
    say("Measure the flatness of a place first: deviations are those from its plane.");
    at("by").value = by;
    return;
  }
  const query = new URLSearchParams({ by: wanted, page: ownName(), plane: last }).toString(), problem = await showScale(query);
  if (problem) { say(problem); at("by").value = by; return; }
  by = wanted; plane = last;
  photographs();
  drawing.recolour(query);
}

// A panorama shows no other colours than the photograph's.
function photographs() { drawing.photographs = at("photographs").checked && by === "photograph"; drawing.moved(); }

// The part of the picture that the panel leaves free: beside it at a desk, above it on a telephone.
function fit() {
  const panel = at("panel").getBoundingClientRect(), width = canvas.clientWidth, height = canvas.clientHeight, below = panel.width > 0.9 * width;
  if (!panel.width) return;
  camera.fit(width, height, below ? 0 : 1 - panel.left / width, below ? 1 - panel.top / height : 0);
  drawing.moved();
}

// The clouds that are shown; all if none is.
const looked = () => { const some = drawing.clouds.filter((cloud) => cloud.visible); return some.length ? some : drawing.clouds; };
function bounds() {
  const low = [0, 1, 2].map((k) => Math.min(...looked().map((cloud) => cloud.low[k] + cloud.shift[k])));
  return [low, [0, 1, 2].map((k) => Math.max(...looked().map((cloud) => cloud.high[k] + cloud.shift[k])))];
}
// The parts of a cloud to be seen from outside: its tiles, as far as they are not strays.
const balls = ({ chunks, low, high, shift }) => chunks.filter((chunk) => chunk[GAP_M] > 1e8).map((chunk) =>
  [[0, 1, 2].map((k) => Math.min(high[k], Math.max(low[k], chunk[X + k])) + shift[k]), chunk[RADIUS]]);
const top = ({ low, high, shift }) => [0, 1, 2, 3].map((bits) => moved([[low, high][bits & 1][0], [low, high][bits >> 1][1], high[2]], shift));

// Side by side as one sees them from outside, on one floor.
function apart() {
  const right = [-Math.sin(OUTSIDE.yaw), Math.cos(OUTSIDE.yaw), 0], [first] = drawing.clouds;
  const along = (cloud) => [0, 1].reduce((sum, k) => sum + (Math.abs(right[k]) * (cloud.high[k] - cloud.low[k])) / 2, 0);
  let place = -along(first);
  for (const cloud of drawing.clouds) {
    const half = along(cloud), middle = (k) => (first.low[k] + first.high[k] - cloud.low[k] - cloud.high[k]) / 2 + right[k] * (place + half);
    cloud.shift = at("apart").checked ? [middle(0), middle(1), first.low[2] - cloud.low[2]] : [...cloud.home];
    if (cloud.visible) place += 2 * GAP * half;
  }
  enclose();
  look("outside");
}

// A section around all that is shown.
function enclose() {
  box = new Box(...bounds(), walls(), cut);
  cut();
}

function cut() {
  drawing.section = at("section").checked ? box.cut() : null;
  drawing.moved();
}

// By how much the walls of the first cloud that knows them are turned.
const walls = () => looked().find((cloud) => cloud.walls !== null)?.walls ?? 0;

function look(where) {
  if (where === "above") camera.above(...bounds(), looked().flatMap(balls), walls());
  else if (where === "outside") camera.stand(...bounds(), looked().flatMap(balls));
  else {
    drawing.standing = { cloud: where.cloud, place: moved(where.xyz, where.cloud.shift) };
    camera.enter(drawing.standing.place);
  }
  drawing.moved();
}

const close = () => order({ do: "close" });
const choose = (what) => () => order({ do: "choose", what }), station = (number) => () => at(`station-${number}`)?.click();
takeHands(canvas, camera, drawing, {
  box: sectioned, pick,
  keys: {
    p: choose("point"), d: choose("distance"), h: choose("height"), n: choose("angle"), q: choose("area"), f: choose("flatness"), c: close,
    u: () => order({ do: "undo" }), Escape: () => { if (state.measuring || state.places.length) order({ do: "cancel" }); },
    b: () => at("backs-part").hidden || at("backs").click(), o: () => look("outside"), a: () => look("above"), s: station(1),
    ...Object.fromEntries([1, 2, 3, 4, 5, 6, 7, 8, 9].map((number) => [number, station(number)])),
  },
});
canvas.ondblclick = () => { const last = state.measured.at(-1), place = last?.at.length && placed(last.at.at(-1)); if (place) { camera.about(place); drawing.moved(); } };
canvas.addEventListener("webglcontextlost", () => { at("lost").hidden = false; });
canvas.addEventListener("webglcontextrestored", () => { at("lost").hidden = true; });
addEventListener("resize", fit);

for (const kind of ["point", "distance", "height", "angle", "area", "flatness"]) at(kind).onclick = choose(kind);
for (const what of ["undo", "clear"]) at(what).onclick = () => order({ do: what });
at("close-outline").onclick = close;
at("room").onclick = () => measure({ do: "room" });
at("volume").onclick = () => order({ do: "box", ...shown(), ...box.cut() });
at("save-section").onclick = saveSection;
at("picture").onclick = savePicture;
at("surface").onchange = join;
at("shades").onchange = () => { drawing.shades = at("shades").checked; drawing.moved(); };
for (const what of ["csv", "json"]) at(what).onclick = () => order({ do: "save", what });
for (const where of ["outside", "above"]) at(where).onclick = () => look(where);
at("by").onchange = colour;
at("photographs").onchange = photographs;
at("apart").onchange = apart;
at("section").onchange = cut;
at("backs").onchange = () => { drawing.backs = !at("backs").checked; drawing.moved(); };
at("budget").oninput = () => { drawing.budget = 1e6 * at("budget").value; at("budget-words").textContent = `${at("budget").value} million`; drawing.later(); };
at("size").oninput = () => { drawing.size = Number(at("size").value); drawing.moved(); };
at("fold").onclick = () => {
  const folded = at("panel").classList.toggle("folded");
  at("fold").textContent = folded ? "more" : "less";
  at("fold").setAttribute("aria-expanded", !folded);
  if (folded) at("measure").open = true;
  fit();
};

async function begin() {
  at("no-webgl").hidden = Boolean(drawing.gl);
  if (!drawing.gl) at("loading").hidden = true;
  const answer = await fetch("scene");
  if (!answer.ok) { at("loading").textContent = await answer.text(); at("panel").hidden = true; return; }
  scene = await answer.json();
  const named = titles(scene.clouds.map((cloud) => cloud.name));
  drawing.clouds = scene.clouds.map((cloud, number) => ({ ...cloud, number, visible: true, home: cloud.shift, title: named[number] }));
  // The rooms of a project are not of one place.
  at("apart").checked = scene.products;
  // Too far apart for one scene: they stand side by side, always.
  if (drawing.clouds.some((cloud) => Math.hypot(...cloud.home) > FAR_M)) { at("apart").checked = true; at("apart").disabled = true; }
  at("systematic").hidden = scene.systematic;
  at("by").replaceChildren(...scene.colourings.map((by) => { const option = make("option", by); option.value = by; return option; }));
  let stations = 0;
  for (const cloud of drawing.clouds) {
    for (const xyz of cloud.stations) {
      const button = make("button", `station ${++stations}${several() ? ` · ${cloud.title}` : ""}`);
      button.id = `station-${stations}`;
      button.onclick = () => look({ xyz, cloud });
      at("places").append(button);
    }
  }
  const sided = drawing.clouds.filter((cloud) => cloud.sides);
  at("backs-part").hidden = !sided.length;
  // Others are shown from all sides, and may stand before it.
  if (sided.length < drawing.clouds.length) at("backs-of").textContent = sided.length === 1 ? `, of ${sided[0].title}` : `, of ${sided.length} of ${drawing.clouds.length} clouds`;
  at("backs").checked = drawing.clouds.some((cloud) => cloud.hides);
  drawing.backs = !at("backs").checked;
  at("surface-part").hidden = !drawing.surfaces.works || !drawing.clouds.some((cloud) => cloud.surface);
  at("shades-part").hidden = !drawing.shading.works;
  at("photographs-part").hidden = !drawing.clouds.some((cloud) => cloud.panorama);
  at("products-part").hidden = !scene.products;
  at("products-part").ontoggle = () => { if (scene.products && at("products-part").open) showProducts(); };
  at("look-again").onclick = showProducts;
  at("clouds-part").hidden = drawing.clouds.length < 2;
  for (const cloud of drawing.clouds) {
    const label = make("label"), tick = make("input");
    Object.assign(tick, { type: "checkbox", checked: true, onchange: () => { cloud.visible = tick.checked; if (at("apart").checked) apart(); drawing.moved(); } });
    label.append(tick, ` ${cloud.title}`);
    label.title = cloud.name;
    at("clouds").append(label);
  }
  at("budget").oninput();
  fit();
  if (at("apart").checked) apart();
  [by] = scene.colourings;
  drawing.query = new URLSearchParams({ by }).toString();
  showScale(drawing.query);
  enclose();
  look("outside");
  connect();
}
begin();
