// Measurements, drawn over the cloud; names of clouds that stand side by side.
const MARK = "#ffa02e", NAME = "#e6ebf0";
// Canvases that show nothing: to lay an empty one over the cloud anew takes a fifth of the pictures a second.
const empty = new WeakSet();

// `state` is what was measured; `place` gives the place of an end in the scene, null where its cloud is hidden; `box` draws
// itself, or is null; `names` are [text, the corners of the cloud's top].
export function drawMarks(canvas, camera, { state, place, box, names }) {
  const nothing = !(box || state.places?.length || state.measured?.length || names.length);
  if (nothing && empty.has(canvas)) return;
  if (nothing) empty.add(canvas); else empty.delete(canvas);
  const dense = Math.min(devicePixelRatio, 2), width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * dense); canvas.height = Math.round(height * dense);
  // Drawn in memory: Chromium without a graphics processor goes on showing what it should have cleared.
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.scale(dense, dense);
  box?.(pen, width, height);
  pen.lineWidth = 2; pen.font = "600 13px system-ui";
  const spot = (at) => { pen.beginPath(); pen.arc(at[0], at[1], 4, 0, 7); pen.fill(); };
  const line = (a, b) => { pen.beginPath(); pen.moveTo(...a); pen.lineTo(...b); pen.stroke(); };
  const tag = (text, x, y, colour) => {
    const wide = pen.measureText(text).width + 10, free = 2 * camera.middle(width, height)[0];
    // As far as its place is in the picture, a text is so too.
    if (x < free) x = Math.min(x, free - wide);
    pen.fillStyle = "#0d1115cc"; pen.fillRect(x, y, wide, 20);
    pen.fillStyle = colour; pen.fillText(text, x + 5, y + 15);
  };
  const seen = (one) => { const found = place(one); return found && camera.project(found, width, height); };
  for (const [text, corners] of names) {
    const at = corners.map((corner) => camera.project(corner, width, height)), x = at.reduce((sum, one) => sum + one?.[0] / at.length, 0);
    if (at.every(Boolean)) tag(text, x - pen.measureText(text).width / 2 - 5, Math.min(...at.map((one) => one[1])) - 24, NAME);
  }
  pen.strokeStyle = pen.fillStyle = MARK;
  const begun = (state.places ?? []).map(seen).filter(Boolean);
  begun.forEach(spot); begun.slice(1).forEach((end, k) => line(begun[k], end));
  (state.measured ?? []).forEach((one, number) => {
    // The room's lengths lead closely by the eyes of one who stands in it.
    if (one.kind === "room" && camera.standing) return;
    const ends = one.at.map(seen);
    if (!ends.length || ends.some((end) => !end)) return;
    pen.fillStyle = MARK;
    if (ends.length === 2) line(...ends);
    // An outline is closed.
    if (ends.length > 2) ends.forEach((end, k) => line(ends.at(k - 1), end));
    ends.forEach(spot);
    // The room's lengths meet in its middle, so their words stand nearer to an end.
    const share = one.kind === "room" ? 0.75 : 0.5, at = (k) => (ends.length === 2 ? (1 - share) * ends[0][k] + share * ends[1][k] : ends.reduce((sum, end) => sum + end[k] / ends.length, 0)), [x, y] = [at(0), at(1)];
    tag(`${number + 1}: ${one.words[0].split(",")[0]}`, x + 8, y - 24, MARK);
  });
}

// Where Enter measures: an element of its own, which costs no picture that a canvas over the cloud costs.
export function showCross(cross, camera, shown, width, height) {
  cross.hidden = !shown;
  const [left, top] = camera.middle(width, height).map((one) => `${Math.round(one)}px`);
  if (shown && (cross.style.left !== left || cross.style.top !== top)) Object.assign(cross.style, { left, top });
}
