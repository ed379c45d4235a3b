// The panel: choices, and the list of what was measured. All text is text, never markup.
export const at = (id) => document.getElementById(id);

export function make(tag, text = "", kind = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

const ASKS = {
  point: "Click a point.",
  distance: "Click two places: each is averaged over 20 mm, as jaxscan measure distance does.",
  flatness: "Click a flat place: its plane within 200 mm, as jaxscan measure plane does.",
};

export function showState(state) {
  for (const kind of Object.keys(ASKS)) at(kind).classList.toggle("chosen", state.kind === kind);
  at("message").textContent = state.message || ASKS[state.kind];
  at("measured").replaceChildren(...state.measured.map((one) => {
    const item = make("li", one.words.join("; "));
    if (one.command) item.title = one.command;
    return item;
  }));
  at("measured").scrollTop = 1e6;
}

export async function showScale(query) {
  const answer = await fetch(`scale?${query}`);
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
