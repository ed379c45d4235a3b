// What was measured, drawn over the cloud.
const MARK = "#ffa02e";

// `box` draws itself, or is null.
export function drawMarks(canvas, camera, state, place, box) {
  const dense = Math.min(devicePixelRatio, 2), width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * dense); canvas.height = Math.round(height * dense);
  // Drawn in memory: Chromium without a graphics processor goes on showing what it should have cleared.
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.scale(dense, dense);
  box?.(pen, width, height);
  pen.strokeStyle = pen.fillStyle = MARK; pen.lineWidth = 2; pen.font = "600 13px system-ui";
  const spot = (at) => { pen.beginPath(); pen.arc(at[0], at[1], 4, 0, 7); pen.fill(); };
  const seen = (one) => camera.project(place(one), width, height);
  if (state.first) { const at = seen(state.first); if (at) spot(at); }
  (state.measured ?? []).forEach((one, number) => {
    const ends = one.at.map(seen);
    if (!ends.length || ends.some((end) => !end)) return;
    if (ends.length === 2) { pen.beginPath(); pen.moveTo(...ends[0]); pen.lineTo(...ends[1]); pen.stroke(); }
    ends.forEach(spot);
    const middle = [0, 1].map((k) => ends.reduce((sum, end) => sum + end[k], 0) / ends.length);
    const text = `${number + 1}: ${one.words[0].split(",")[0]}`, wide = pen.measureText(text).width;
    pen.fillStyle = "#0d1115cc"; pen.fillRect(middle[0] + 8, middle[1] - 24, wide + 10, 20);
    pen.fillStyle = MARK; pen.fillText(text, middle[0] + 13, middle[1] - 9);
  });
}
