import { compiled } from "./shared.js";
import { Panorama } from "./panorama.js";
import { Shading } from "./shading.js";
import { Surfaces } from "./surface.js";

// Points in WebGL: of each tile as many as the view needs, fewer while it moves.
// `side` points to where a point was seen from; it is zero where nobody knows.
const VERTEX = `attribute vec3 place, colour, side; uniform mat4 view; uniform vec3 middle, low, high, eye; uniform vec2 turn; uniform float size, behind; varying vec3 shown;
void main() {
  vec3 at = place + middle, turned = vec3(turn.x * at.x + turn.y * at.y, turn.x * at.y - turn.y * at.x, at.z);
  gl_Position = view * vec4(at, 1.0);
  if (any(lessThan(turned, low)) || any(greaterThan(turned, high)) || dot(side, eye - at) < behind) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = clamp(size / gl_Position.w, 1.0, 24.0);
  shown = colour;
}`;
const FRAGMENT = "precision mediump float; varying vec3 shown; void main() { gl_FragColor = vec4(shown, 1.0); }";
const NO_SECTION = { section: [[-1e9, -1e9, -1e9], [1e9, 1e9, 1e9]], turn_rad: 0 };
const AT_ONCE = 6, REST_MS = 150, MOVING_S = 1 / 24, RESTING_S = 0.4, LEAST = 5e3, LEAST_AT_REST = 1e5, GAP_PX = 1, KEPT = 3, ON_PLACE_M = 0.06;
// Points a second from which a moving view is shaded, too; the colour of points whose own has not come yet.
const FAST = 2e7, PLAIN = [0.45, 0.45, 0.45];
// A chunk as the server lists it.
const TILE = 0, COUNT = 1, SPACING = 7, PLACE_BYTES = 12;
export const X = 2, RADIUS = 5, GAP = 6;

export class Drawing {
  constructor(canvas, camera, drawn) {
    this.canvas = canvas; this.camera = camera; this.drawn = drawn;
    this.gl = canvas.getContext("webgl", { antialias: false, preserveDrawingBuffer: true });
    this.clouds = []; this.kept = new Map(); this.asked = new Map(); this.query = ""; this.version = 0;
    this.budget = 2e6; this.size = 1; this.section = null;
    // Whether edges are shaded, and whether surfaces are drawn in place of points.
    this.shades = true; this.joined = false;
    // Whether points are drawn that are seen from behind.
    this.backs = true;
    // Points a second; slow until it is known.
    this.rate = 1e6; this.movedAt = -1e9; this.waiting = 0; this.points = 0; this.wanted = []; this.pausing = null;
    // Where one stands in a panorama: {cloud, place}.
    this.standing = null; this.photographs = true;
    if (!this.gl) return;
    this.prepare();
    // A driver that begins anew, or a machine that slept, takes all that was given to WebGL.
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.version++; this.kept.clear(); this.asked.clear(); });
    canvas.addEventListener("webglcontextrestored", () => { this.prepare(); this.later(); });
    new ResizeObserver(() => this.later()).observe(canvas);
  }

  prepare() {
    const gl = this.gl, program = this.program = compiled(gl, VERTEX, FRAGMENT);
    gl.enable(gl.DEPTH_TEST); gl.clearColor(0.05, 0.067, 0.082, 1);
    const make = (...texts) => compiled(gl, ...texts);
    this.panorama = new Panorama(gl, make); this.shading = new Shading(gl, make); this.surfaces = new Surfaces(gl, make);
    this.at = Object.fromEntries(["place", "colour", "side"].map((name) => [name, gl.getAttribLocation(program, name)]));
    this.uniform = Object.fromEntries(["view", "middle", "low", "high", "eye", "turn", "size", "behind"].map((name) => [name, gl.getUniformLocation(program, name)]));
  }

  // The cloud in whose panorama one stands; none away from its place.
  around() {
    const { cloud, place } = this.standing ?? {}, eye = this.camera.eye();
    const there = cloud?.panorama && this.photographs && this.camera.standing && Math.hypot(...place.map((one, k) => one - eye[k])) < ON_PLACE_M;
    return there ? cloud : null;
  }

  // The view has moved: draw at once, with few points, and again when it rests.
  moved() {
    this.movedAt = performance.now(); this.later();
    clearTimeout(this.rest); this.rest = setTimeout(() => this.later(), REST_MS + 10);
  }

  // Surfaces in place of points, of those clouds that have one; returns why others are shown as points.
  async join(joined) {
    this.joined = joined;
    const problems = joined ? await Promise.all(this.clouds.filter((cloud) => cloud.surface).map((cloud) => this.surfaces.load(cloud))) : [];
    this.moved();
    return problems.filter(Boolean).join(" ");
  }
  joins(cloud) { return this.joined && this.surfaces.made.has(cloud.number); }

  // Other colours: those that are kept are asked for again.
  recolour(query) {
    this.query = query; this.version++;
    this.asked.clear();
    this.later();
  }

  later() { if (this.gl && !this.waiting) this.waiting = requestAnimationFrame(() => { this.waiting = 0; this.draw(); }); }
  // Only what is drawn over the cloud has changed.
  marked() { if (!this.waiting && !this.marking) this.marking = requestAnimationFrame(() => { this.marking = 0; if (!this.waiting) this.drawn(this.around()); }); }
  moves() { return performance.now() - this.movedAt < REST_MS; }

  draw() {
    if (this.gl.isContextLost()) return;
    const gl = this.gl, canvas = this.canvas, dense = Math.min(devicePixelRatio, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * dense)), height = Math.max(1, Math.round(canvas.clientHeight * dense));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const around = this.around();
    if (around) {
      gl.viewport(0, 0, width, height);
      if (this.panorama.draw(around, this.camera, width, height, () => this.later())) return this.drawn(around);
    }
    const begun = performance.now(), moves = this.moves(), focal = this.camera.focal(width, height);
    const time = moves ? MOVING_S : RESTING_S, most = Math.max(this.rate * time, moves ? LEAST : LEAST_AT_REST);
    const wanted = this.chosen(focal, this.camera.halfView(width, height), Math.min(most, this.budget));
    const shown = wanted.filter((one) => this.kept.has(one.key)), finest = new Map();
    for (const { cloud, chunk } of shown) {
      const tile = 1000 * cloud.number + chunk[TILE];
      finest.set(tile, Math.min(chunk[SPACING], finest.get(tile) ?? Infinity));
    }
    const shaded = this.shades && this.shading.works && (!moves || this.rate > FAST);
    if (shaded) this.shading.begin(width, height, dense);
    gl.viewport(0, 0, width, height); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { section: [low, high], turn_rad: turn } = this.section ?? NO_SECTION, matrix = this.camera.matrix(width, height);
    this.points = 0;
    for (const cloud of this.clouds.filter((one) => one.visible && this.joins(one))) {
      const view = { matrix, eye: this.camera.eye(), section: [low, high], turn, version: this.version };
      this.points += this.surfaces.draw(cloud, { ...view, backs: this.backs || !cloud.sides });
    }
    gl.useProgram(this.program); for (const one of Object.values(this.at)) gl.enableVertexAttribArray(one);
    gl.uniformMatrix4fv(this.uniform.view, false, matrix);
    gl.uniform3fv(this.uniform.low, low); gl.uniform3fv(this.uniform.high, high);
    gl.uniform3fv(this.uniform.eye, this.camera.eye());
    gl.uniform2f(this.uniform.turn, Math.cos(turn), Math.sin(turn));
    for (const { key, cloud, chunk } of shown) {
      const { place, colour, version } = this.kept.get(key);
      gl.uniform3f(this.uniform.middle, ...[0, 1, 2].map((k) => chunk[X + k] + cloud.shift[k]));
      gl.uniform1f(this.uniform.size, 1.3 * this.size * focal * finest.get(1000 * cloud.number + chunk[TILE]));
      gl.bindBuffer(gl.ARRAY_BUFFER, place); gl.vertexAttribPointer(this.at.place, 3, gl.FLOAT, false, 0, 0);
      // Behind the places, of clouds that know them. Others read any bytes, which change nothing.
      const sides = cloud.sides ? PLACE_BYTES * chunk[COUNT] : 0;
      gl.vertexAttribPointer(this.at.side, 3, gl.BYTE, true, 0, sides);
      gl.uniform1f(this.uniform.behind, cloud.sides && !this.backs ? 0 : -1e9);
      // Under a new legend no colour of the old one is shown.
      if (version === this.version) {
        gl.bindBuffer(gl.ARRAY_BUFFER, colour); gl.enableVertexAttribArray(this.at.colour); gl.vertexAttribPointer(this.at.colour, 3, gl.UNSIGNED_BYTE, true, 0, 0);
      } else { gl.disableVertexAttribArray(this.at.colour); gl.vertexAttrib3f(this.at.colour, ...PLAIN); }
      gl.drawArrays(gl.POINTS, 0, chunk[COUNT]);
      this.points += chunk[COUNT];
    }
    for (const one of Object.values(this.at)) gl.disableVertexAttribArray(one);
    // Waits until it is drawn, so that the time is that of drawing points.
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    this.took = (performance.now() - begun) / 1000;
    if (shaded) this.shading.end(this.camera.depths());
    if (this.points > 2000) this.rate += 0.3 * (this.points / this.took - this.rate);
    if (!moves) this.load(wanted);
    if (!moves && this.joined) this.surfaces.recolour(this.query, this.version, () => this.later());
    this.drawn(null);
  }

  // The chunks to show, the most needed first: those whose gaps would look largest.
  chosen(focal, halfView, budget) {
    const eye = this.camera.eye(), ahead = this.camera.forward(), found = [];
    for (const cloud of this.clouds) {
      if (!cloud.visible || this.joins(cloud)) continue;
      cloud.chunks.forEach((chunk, index) => {
        const x = chunk[X] + cloud.shift[0] - eye[0], y = chunk[X + 1] + cloud.shift[1] - eye[1], z = chunk[X + 2] + cloud.shift[2] - eye[2];
        const distance = Math.max(Math.hypot(x, y, z), 1e-9), radius = chunk[RADIUS];
        if (distance > radius) {
          const towards = Math.acos(Math.min(1, Math.max(-1, (x * ahead[0] + y * ahead[1] + z * ahead[2]) / distance)));
          if (towards > halfView + Math.asin(radius / distance)) return;
        }
        const looks = (chunk[GAP] * focal) / Math.max(distance - radius, 0.05);
        if (looks > GAP_PX) found.push({ key: `${cloud.number}/${index}`, cloud, chunk, looks });
      });
    }
    found.sort((a, b) => b.looks - a.looks);
    let sum = 0;
    return found.filter(({ chunk }) => (sum += chunk[COUNT]) <= budget || chunk[GAP] > 1e8);
  }

  load(wanted) {
    this.wanted = wanted;
    for (const { key } of wanted) {
      if (this.asked.size >= AT_ONCE) return;
      const kept = this.kept.get(key);
      if (this.asked.has(key) || kept?.version === this.version) continue;
      this.asked.set(key, this.fetch(key, this.version, kept));
    }
    this.forget(new Set(wanted.map((one) => one.key)));
  }

  async fetch(key, version, kept) {
    const body = async (path) => { const answer = await fetch(path); if (!answer.ok) throw new Error(path); return answer.arrayBuffer(); };
    try {
      const [place, colour] = await Promise.all([kept ? null : body(`points/${key}`), body(`colours/${key}?${this.query}`)]);
      if (version !== this.version) return;
      if (kept) this.gl.deleteBuffer(kept.colour);
      this.kept.set(key, { place: kept?.place ?? this.buffer(place), colour: this.buffer(colour), version, bytes: colour.byteLength });
      this.asked.delete(key);
    } catch (problem) {
      // Asked for again with the next picture, which the next motion draws.
      if (version === this.version) this.asked.delete(key);
      return;
    }
    this.load(this.wanted);
    // Pictures take time where there is no graphics processor: more of it goes into loading.
    if (!this.asked.size) this.later();
    else this.pausing ??= setTimeout(() => { this.pausing = null; this.later(); }, 3000 * (this.took ?? 0));
  }

  buffer(data) {
    const gl = this.gl, made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    return made;
  }

  // Keeps the points that were seen last, within a bound.
  forget(wanted) {
    let bytes = 0;
    for (const { bytes: one } of this.kept.values()) bytes += one;
    for (const [key, { place, colour, bytes: one }] of this.kept) {
      if (bytes <= 3 * KEPT * this.budget) return;
      if (wanted.has(key)) continue;
      this.gl.deleteBuffer(place); this.gl.deleteBuffer(colour);
      this.kept.delete(key); bytes -= one;
    }
  }
}
