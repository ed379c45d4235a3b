// Points in WebGL, brighter than they were seen: drag or arrow keys turn, wheel or + and - zoom.
import { compiled } from "/shared.js";

const VERTEX = `attribute vec3 place; attribute vec3 colour; uniform mat4 view; uniform float size; varying vec3 shown;
void main() { gl_Position = view * vec4(place, 1.0); gl_PointSize = clamp(size / gl_Position.w, 1.5, 6.0); shown = sqrt(colour); }`;
const FRAGMENT = "precision mediump float; varying vec3 shown; void main() { gl_FragColor = vec4(shown, 1.0); }";

const FOCAL = 1.6;

export class Cloud {
  constructor(canvas, missing, count, empty) {
    this.canvas = canvas; this.count = count; this.empty = empty;
    this.gl = canvas.getContext("webgl", { antialias: false, preserveDrawingBuffer: true });
    missing.hidden = Boolean(this.gl);
    canvas.hidden = !this.gl;
    this.turn = 0.6; this.tilt = 0.5; this.away = 9; this.number = 0; this.chunks = []; this.points = 0;
    // Some of the places without strays, by which the view is chosen until a person zooms, and their middle.
    this.some = []; this.within = []; this.middle = [0, 0, 0]; this.zoomed = false;
    if (this.gl) { this.prepare(); this.listen(); this.draw(); }
    this.tell();
  }

  prepare() {
    const gl = this.gl, program = compiled(gl, VERTEX, FRAGMENT);
    gl.useProgram(program); gl.enable(gl.DEPTH_TEST); gl.clearColor(0.04, 0.05, 0.06, 1);
    this.place = gl.getAttribLocation(program, "place"); this.colour = gl.getAttribLocation(program, "colour");
    this.view = gl.getUniformLocation(program, "view"); this.size = gl.getUniformLocation(program, "size");
  }

  clear(number) {
    for (const chunk of this.chunks) { this.gl.deleteBuffer(chunk.place); this.gl.deleteBuffer(chunk.colour); }
    this.number = number; this.chunks = []; this.points = 0; this.some = []; this.within = []; this.zoomed = false;
    this.tell(); this.later();
  }

  // Coordinates as float32, then colours as bytes.
  add(number, data) {
    if (number !== this.number) { if (this.gl) this.clear(number); this.number = number; }
    const points = Math.floor(data.byteLength / 15);
    this.points += points; this.tell();
    if (!this.gl || !points) return;
    const gl = this.gl, buffer = (array) => {
      const made = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
      return made;
    };
    this.chunks.push({ points, place: buffer(new Float32Array(data, 0, 3 * points)), colour: buffer(new Uint8Array(data, 12 * points, 3 * points)) });
    this.enclose(new Float32Array(data, 0, 3 * points));
    this.later();
  }

  // Without what lies far beyond all but the outermost hundredth: strays are not the room, but corners are.
  enclose(places) {
    const points = places.length / 3, step = Math.max(1, Math.floor(points / 2000));
    for (let k = 0; k < points; k += step) this.some.push([...places.subarray(3 * k, 3 * k + 3)]);
    if (this.some.length > 4000) this.some = this.some.filter((_, k) => k % 2);
    const ends = [0, 1, 2].map((axis) => {
      const along = this.some.map((one) => one[axis]).sort((a, b) => a - b);
      return [along[Math.floor(0.01 * along.length)], along[Math.ceil(0.99 * along.length) - 1]];
    });
    this.middle = ends.map(([low, high]) => (low + high) / 2);
    this.within = this.some.filter((one) => ends.every(([low, high], axis) => Math.abs(one[axis] - this.middle[axis]) <= 0.6 * (high - low)));
  }

  tell() { this.empty.hidden = !this.gl || this.points > 0; this.count.textContent = this.points ? `${this.points.toLocaleString("en")} points shown` : ""; }

  listen() {
    const canvas = this.canvas;
    canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = (event) => { if (event.buttons) this.go(-event.movementX / 200, event.movementY / 200); };
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY / 600)); }, { passive: false });
    canvas.onkeydown = ({ key }) => {
      const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
      if (steps[key]) this.go(...steps[key]);
      if (key === "+") this.zoom(0.9);
      if (key === "-") this.zoom(1.1);
    };
    new ResizeObserver(() => this.later()).observe(canvas);
  }

  go(turn, tilt) { this.turn += turn; this.tilt = Math.min(1.5, Math.max(-1.5, this.tilt + tilt)); this.later(); }
  zoom(factor) { this.zoomed = true; this.away = Math.min(60, Math.max(0.5, this.away * factor)); this.later(); }
  later() { if (!this.waiting && this.gl) this.waiting = requestAnimationFrame(() => { this.waiting = 0; this.draw(); }); }

  draw() {
    const gl = this.gl, canvas = this.canvas, dense = Math.min(devicePixelRatio, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * dense)), height = Math.max(1, Math.round(canvas.clientHeight * dense));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    if (!this.zoomed && this.within.length) this.away = this.fitting(width / height);
    gl.viewport(0, 0, width, height); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.view, false, this.matrix(width / height)); gl.uniform1f(this.size, height / 60);
    for (const chunk of this.chunks) {
      gl.bindBuffer(gl.ARRAY_BUFFER, chunk.place); gl.enableVertexAttribArray(this.place); gl.vertexAttribPointer(this.place, 3, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, chunk.colour); gl.enableVertexAttribArray(this.colour); gl.vertexAttribPointer(this.colour, 3, gl.UNSIGNED_BYTE, true, 0, 0);
      gl.drawArrays(gl.POINTS, 0, chunk.points);
    }
  }

  // Right, up and back of the camera.
  axes() {
    const [ct, st, ce, se] = [Math.cos(this.turn), Math.sin(this.turn), Math.cos(this.tilt), Math.sin(this.tilt)];
    return [[-st, ct, 0], [-se * ct, -se * st, ce], [ce * ct, ce * st, se]];
  }

  // From so far away all of it is in the picture, with a margin.
  fitting(aspect) {
    const along = (axis, place) => axis.reduce((sum, part, i) => sum + part * (place[i] - this.middle[i]), 0), [right, up, back] = this.axes();
    return Math.max(0.5, ...this.within.map((one) => along(back, one) + 1.06 * FOCAL * Math.max(Math.abs(along(right, one)) / aspect, Math.abs(along(up, one)))));
  }

  // Perspective times a camera that circles the middle, z up; column after column.
  matrix(aspect) {
    const f = FOCAL, near = 0.05, far = 200, a = (far + near) / (near - far), b = (2 * far * near) / (near - far);
    const [right, up, back] = this.axes();
    const column = (i) => [(f / aspect) * right[i], f * up[i], a * back[i], -back[i]];
    // The camera looks at the middle from `away`.
    const moved = [0, 1, 2, 3].map((row) => -[0, 1, 2].reduce((sum, axis) => sum + column(axis)[row] * this.middle[axis], 0));
    return new Float32Array([...column(0), ...column(1), ...column(2), moved[0], moved[1], moved[2] - a * this.away + b, moved[3] + this.away]);
  }
}
