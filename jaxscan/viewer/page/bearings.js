// Where one is: the axes of the scene, a scale bar, and the picture of all that as a file.
const AXES = [["x", "#ff7b72", [1, 0, 0]], ["y", "#7ee787", [0, 1, 0]], ["z", "#79c0ff", [0, 0, 1]]];
const BAR_PX = [70, 180], INK = "#e6ebf0", GROUND = "#0d1115cc";

// The three axes as the camera sees them, about a place of the picture; those that point away first.
export function drawAxes(pen, camera, x, y, length) {
  const views = [camera.right(), camera.up(), camera.back()];
  const seen = AXES.map(([name, colour, axis]) => ({ name, colour, to: views.map((view) => view.reduce((sum, one, k) => sum + one * axis[k], 0)) }));
  pen.lineWidth = 2; pen.font = "600 12px system-ui"; pen.textAlign = "center"; pen.textBaseline = "middle";
  for (const { name, colour, to: [right, up] } of seen.sort((a, b) => a.to[2] - b.to[2])) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x + length * right, y - length * up); pen.stroke();
    pen.fillText(name, x + (length + 9) * right, y - (length + 9) * up);
  }
  pen.textAlign = "start"; pen.textBaseline = "alphabetic";
}

// A length of 1, 2 or 5 times a power of ten, as long in the picture as people like it, where the middle of the view is.
export function scaleBar(camera, width, height) {
  if (camera.standing || !(camera.away > 0)) return null;
  const each = camera.focal(width, height) / camera.away, power = 10 ** Math.floor(Math.log10(BAR_PX[1] / each));
  const metres = [5, 2, 1].map((one) => one * power).find((one) => one * each <= BAR_PX[1]);
  return { px: metres * each, words: metres >= 1 ? `${metres} m` : metres >= 0.01 ? `${Math.round(100 * metres)} cm` : `${Math.round(1000 * metres)} mm` };
}

// Shows them on the page: `canvas` is that of the axes, `bar` an element as long as the scale.
export function showBearings(canvas, bar, camera, width, height) {
  const dense = Math.min(devicePixelRatio, 2), size = canvas.clientWidth;
  // Anew only when the view has turned: a canvas costs time where there is no graphics processor.
  const turned = `${camera.yaw} ${camera.pitch} ${size}`;
  if (canvas.dataset.turned !== turned) {
    canvas.dataset.turned = turned;
    canvas.width = canvas.height = Math.round(size * dense);
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    pen.scale(dense, dense);
    drawAxes(pen, camera, size / 2, size / 2, 0.33 * size);
  }
  const scale = scaleBar(camera, width, height);
  bar.hidden = !scale;
  if (!scale) return;
  bar.style.width = `${Math.round(scale.px)}px`;
  if (bar.textContent !== scale.words) bar.textContent = scale.words;
}

// What is seen, with axes, scale bar, names and legend, as a PNG.
export function takePicture(cloud, marks, camera, { caption, legend }) {
  const made = document.createElement("canvas"), pen = made.getContext("2d"), dense = cloud.width / cloud.clientWidth;
  made.width = cloud.width; made.height = cloud.height;
  pen.drawImage(cloud, 0, 0);
  if (marks.width) pen.drawImage(marks, 0, 0, made.width, made.height);
  pen.scale(dense, dense);
  const [width, height] = [cloud.clientWidth, cloud.clientHeight];
  drawAxes(pen, camera, 50, height - 80, 32);
  const write = (text, x, y) => {
    pen.font = "14px system-ui"; pen.fillStyle = GROUND; pen.fillRect(x - 4, y - 15, pen.measureText(text).width + 8, 20);
    pen.fillStyle = INK; pen.fillText(text, x, y);
  };
  const scale = scaleBar(camera, width, height);
  if (scale) { pen.fillStyle = INK; pen.fillRect(16, height - 22, scale.px, 4); write(scale.words, 16, height - 28); }
  write(caption, 16, 26);
  if (legend) { pen.drawImage(legend.bar, 16, 40, 180, 10); write(legend.words, 16, 70); }
  return new Promise((done) => made.toBlob(done, "image/png"));
}
