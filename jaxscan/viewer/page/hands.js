// Hands: one finger or the left button turns, two fingers or another button move, a tap measures; handles are dragged; keys.
const STILL_PX = 5, STEP_RAD = 0.08, STEP_PX = 60;

// `box()` is the section's while it is shown, else null; `pick` measures at a place of the picture; `keys` are further ones.
export function takeHands(canvas, camera, drawing, { box, pick, keys }) {
  const size = () => [canvas.clientWidth, canvas.clientHeight], fingers = new Map();
  let travelled = 0, spread = 0, held = -1;
  // The side of the section whose handle a pointer is on; -1 if on none.
  const grasped = (event) => box()?.handleAt(event.offsetX, event.offsetY, camera, ...size(), event.pointerType === "touch") ?? -1;
  const hold = (side) => { held = side; if (box()) box().held = side; };

  canvas.oncontextmenu = (event) => event.preventDefault();
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (!fingers.size) { travelled = 0; hold(grasped(event)); }
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size > 1) { travelled = STILL_PX + 1; hold(-1); }
    spread = 0;
  };
  canvas.onpointermove = (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) { canvas.style.cursor = grasped(event) < 0 ? "" : "grab"; return; }
    const dx = event.clientX - before[0], dy = event.clientY - before[1];
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    travelled += Math.hypot(dx, dy);
    if (held >= 0) return box()?.drag(held, dx, dy, camera, ...size());
    if (travelled <= STILL_PX) return;
    if (fingers.size > 1) {
      const [a, b] = [...fingers.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (spread) camera.zoom(spread / now);
      spread = now;
      // In a panorama two fingers look closer; they do not lead out of it.
      if (!drawing.around()) camera.move(dx / 2, dy / 2, ...size());
    } else if (event.shiftKey || event.buttons > 1) camera.move(dx, dy, ...size());
    else camera.drag(dx, dy, ...size());
    drawing.moved();
  };
  canvas.onpointerup = (event) => {
    fingers.delete(event.pointerId);
    if (held >= 0) { hold(-1); drawing.later(); } else if (travelled <= STILL_PX && event.button === 0) pick(event.offsetX, event.offsetY);
  };
  canvas.onpointercancel = (event) => { fingers.delete(event.pointerId); hold(-1); };
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); camera.zoom(Math.exp(event.deltaY / 600)); drawing.moved(); }, { passive: false });
  canvas.onfocus = canvas.onblur = () => drawing.later();

  const arrow = (x, y) => (event) => {
    if (event.shiftKey) camera.move(-STEP_PX * x, STEP_PX * y, ...size());
    else camera.turn(STEP_RAD * x, STEP_RAD * (camera.standing ? -y : y));
  };
  const all = {
    ...keys, "+": () => camera.zoom(0.85), "-": () => camera.zoom(1.18), Enter: () => pick(...camera.middle(...size())),
    ArrowLeft: arrow(-1, 0), ArrowRight: arrow(1, 0), ArrowUp: arrow(0, 1), ArrowDown: arrow(0, -1),
  };
  addEventListener("keydown", (event) => {
    const work = all[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    // Sliders and choices have keys of their own; buttons are pressed by Enter.
    const own = event.key === "Enter" ? "button, summary, input, select" : "select, input:not([type=checkbox])";
    if (!work || event.ctrlKey || event.metaKey || event.altKey || event.target.matches(own)) return;
    event.preventDefault(); work(event); drawing.moved();
  });
}
