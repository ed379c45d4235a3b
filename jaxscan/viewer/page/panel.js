// The panel: choices, and the list of what was measured.
import { at, make } from "./shared.js";

const ASKS = {
  point: "Click a point.",
  distance: "Click two places: each is averaged over 20 mm, as jaxscan measure distance does.",
  height: "Click two places: how much higher the second is, each averaged over 20 mm.",
  angle: "Click two walls: the angle between their planes within 200 mm, 90 degrees in a square corner.",
  area: "Click the corners of an area, then the first one again.",
  flatness: "Click a flat place: its plane within 200 mm, as jaxscan measure plane does.",
};

// `nameOf` gives the name of a measurement's cloud, "" if there is only one; `remove` takes one back.
export function showState(state, nameOf, remove) {
  for (const kind of Object.keys(ASKS)) {
    at(kind).classList.toggle("chosen", state.kind === kind);
    at(kind).setAttribute("aria-pressed", state.kind === kind);
  }
  if (state.message || !state.measuring) say(state.message || ASKS[state.kind]);
  at("close-outline").hidden = state.kind !== "area" || state.places.length < 3;
  const focused = at("measured").contains(document.activeElement), some = state.measured.length > 0;
  at("measured").replaceChildren(...state.measured.map((one, number) => {
    const item = make("li"), name = nameOf(one);
    if (name) item.append(make("span", `${name}: `, "quiet"));
    item.append(make("span", one.words.join("; "), "words"));
    const buttons = make("span", "", "together");
    if (one.command) {
      item.title = one.command;
      buttons.append(small("copy", `the command that measures ${number + 1}`, () => copy(one.command)));
    }
    buttons.append(small("×", `remove ${number + 1}`, () => remove(one.id)));
    item.append(buttons);
    return item;
  }));
  at("measured").scrollTop = 1e6;
  for (const id of ["csv", "json", "clear"]) at(id).disabled = !some;
  at("undo").disabled = !some && !state.places.length && !state.measuring;
  // The button that was pressed is gone.
  if (focused) (at("measured").querySelector("li:last-child button:last-child") ?? at(state.kind)).focus();
}

function small(text, label, press) {
  const button = make("button", text, "small");
  button.setAttribute("aria-label", label); button.title = label;
  button.onclick = press;
  return button;
}

// Only a page of this machine, or one over HTTPS, may write to the clipboard; elsewhere the command is there to be marked.
async function copy(command) {
  try { await navigator.clipboard.writeText(command); say(`Copied: ${command}`); } catch { say(command); }
}

let ticking = 0;
// A line about what was done.
export function say(text) { clearInterval(ticking); at("seconds").textContent = ""; at("message").textContent = text; }
// A line about what goes on, and for how long.
export function sayWaiting(text) {
  say(text);
  const begun = performance.now();
  ticking = setInterval(() => { at("seconds").textContent = `${Math.round((performance.now() - begun) / 1000)} s; Esc or undo ends it`; }, 1000);
}

// The shortest names by which clouds can be told apart: their files', or the whole paths.
export function titles(names) {
  const short = names.map((name) => name.split("/").at(-1));
  return new Set(short).size === names.length ? short : names;
}

export async function showScale(query) {
  const answer = await fetch(`scale?${query}`).catch(() => null);
  if (!answer) return "No connection to jaxscan view: the colours stay.";
  if (!answer.ok) return (await answer.text()).trim();
  const scale = await answer.json();
  at("scale").hidden = !scale;
  if (!scale) return "";
  const pen = at("bar").getContext("2d"), picture = pen.createImageData(32, 1);
  scale.bar.forEach((rgb, k) => picture.data.set([...rgb, 255], 4 * k));
  pen.putImageData(picture, 0, 0);
  at("scale-words").textContent = scale.words + (scale.diverging ? "; white is the plane, red is on its side towards the scanner" : "");
  return "";
}

export async function showProducts() {
  at("products-words").textContent = "looking …";
  const answer = await fetch("products").catch(() => null);
  if (!answer?.ok) {
    at("products-words").textContent = answer ? (await answer.text()).trim() : "No connection to jaxscan view.";
    return;
  }
  const { counts, rows } = await answer.json();
  const more = Object.values(counts).reduce((a, b) => a + b, 0) - rows.length;
  at("products-words").textContent = Object.entries(counts).map(([state, count]) => `${count} ${state}`).join(", ");
  at("products").replaceChildren(...rows.map(([name, state, why]) => {
    const item = make("li");
    item.append(make("span", state, state), ` ${name}`);
    if (why) item.append(make("p", why, "quiet"));
    return item;
  }), ...(more > 0 ? [make("li", `and ${more} more`)] : []));
}
