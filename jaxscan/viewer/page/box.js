// The section: a box of the scene, turned about z. Its sides are moved by sliders, and by handles that are drawn over the cloud.
import { at, make } from "./shared.js";

const MARGIN_M = 0.2, REACH_PX = 12, FINGER_PX = 26, LEAST_M = 0.01, NEAR_M = 0.02, STEEP_PX = 4, COLOUR = "#6fb3ff", FAR_M = 1e6, STEP_M = 0.01;
// Corners by bits: 1 is the far side along x, 2 along y, 4 along z.
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7];
const EDGES = CORNERS.flatMap((corner) => [1, 2, 4].filter((bit) => !(corner & bit)).map((bit) => [corner, corner | bit]));
const turned = ([x, y, z], angle) => { const c = Math.cos(angle), s = Math.sin(angle); return [c * x - s * y, s * x + c * y, z]; };

export class Box {
  // Around a scene, along its walls; `changed` is called when a side has moved.
  constructor(low, high, angle, changed) {
    this.scene = [low.map((one) => one - MARGIN_M), high.map((one) => one + MARGIN_M)];
    // The box turns about the middle of the scene.
    this.middle = low.map((one, k) => (one + high[k]) / 2);
    this.changed = changed; this.held = -1; this.angle = angle;
    this.bound();
    // Of each axis from and to.
    this.sides = this.ends();
    this.rows = [...this.sides.map((_, side) => this.row(side)), this.turning()];
    at("box").replaceChildren(...this.rows.map((row) => row.label));
    this.tell();
  }

  // How far the sides reach: to the ends of the scene along the box's own axes.
  bound() {
    const all = CORNERS.map((bits) => this.inBox([0, 1, 2].map((k) => this.scene[(bits >> k) & 1][k])));
    [this.least, this.most] = [Math.min, Math.max].map((end) => [0, 1, 2].map((k) => end(...all.map((one) => one[k]))));
  }
  ends() { return [0, 1, 2].flatMap((axis) => [this.least[axis], this.most[axis]]); }
  full(side) { const [least, most] = [this.least[side >> 1], this.most[side >> 1]]; return side % 2 ? this.sides[side] > most - STEP_M : this.sides[side] < least + STEP_M; }

  inBox(place) { return turned(place.map((one, k) => one - this.middle[k]), -this.angle).map((one, k) => one + this.middle[k]); }
  inScene(place) { return turned(place.map((one, k) => one - this.middle[k]), this.angle).map((one, k) => one + this.middle[k]); }

  row(side) {
    const name = "xyz"[side >> 1], end = side % 2 ? "to" : "from";
    return this.slider(`${name} ${end} `, { step: STEP_M, id: `${name}-${end}` }, (value) => this.set(side, value));
  }
  turning() { return this.slider("turn ", { min: -45, max: 45, step: 0.5, id: "turn" }, (value) => this.turn((value * Math.PI) / 180)); }

  slider(name, settings, moved) {
    const label = make("label", name), slider = make("input"), told = make("output");
    Object.assign(slider, { type: "range", ...settings });
    slider.oninput = () => moved(Number(slider.value));
    label.append(told, slider);
    return { label, slider, told };
  }

  set(side, value) { this.sides[side] = value; this.tell(); this.changed(); }

  // Sides that left nothing out go on leaving nothing out.
  turn(angle) {
    const full = this.sides.map((_, side) => this.full(side));
    this.angle = angle; this.bound();
    this.sides = this.ends().map((end, side) => (full[side] ? end : Math.max(this.least[side >> 1], Math.min(this.most[side >> 1], this.sides[side]))));
    this.tell(); this.changed();
  }

  tell() {
    this.rows.forEach(({ slider, told }, side) => {
      if (side === 6) { slider.value = (180 * this.angle) / Math.PI; told.textContent = `${((180 * this.angle) / Math.PI).toFixed(1)}°`; return; }
      Object.assign(slider, { min: this.least[side >> 1], max: this.most[side >> 1] });
      slider.value = this.sides[side]; told.textContent = this.full(side) ? "all" : `${this.sides[side].toFixed(2)} m`;
    });
  }

  // Lowest and highest corner, of coordinates turned about the scene's z axis; far away where a side leaves nothing out.
  cut() {
    const about = turned(this.middle, -this.angle), moved = (side) => this.sides[side] + about[side >> 1] - this.middle[side >> 1];
    const section = [0, 1].map((end) => [0, 1, 2].map((axis) => (this.full(2 * axis + end) ? (end ? FAR_M : -FAR_M) : moved(2 * axis + end))));
    return { section, turn_rad: this.angle };
  }

  // The middle of a side, moved along its axis.
  handle(side, along = 0) {
    const axis = side >> 1;
    return this.inScene([0, 1, 2].map((k) => (k === axis ? this.sides[side] + along : (this.sides[2 * k] + this.sides[2 * k + 1]) / 2)));
  }

  // The side whose handle is nearest to a place of the picture, within reach; -1 if there is none.
  handleAt(x, y, camera, width, height, finger) {
    let found = -1, best = finger ? FINGER_PX : REACH_PX;
    this.sides.forEach((_, side) => {
      const seen = camera.project(this.handle(side), width, height), away = seen ? Math.hypot(seen[0] - x, seen[1] - y) : Infinity;
      if (away <= best) { found = side; best = away; }
    });
    return found;
  }

  // Moves a side as far as a way in the picture leads along its axis.
  drag(side, dx, dy, camera, width, height) {
    const step = 0.01 * Math.max(camera.away, 0.5), from = camera.project(this.handle(side), width, height), to = camera.project(this.handle(side, step), width, height);
    if (!from || !to) return;
    const way = [(to[0] - from[0]) / step, (to[1] - from[1]) / step], long = Math.hypot(...way), axis = side >> 1;
    // Along the line of sight no way in the picture leads anywhere.
    if (long < STEEP_PX) return;
    const value = this.sides[side] + (dx * way[0] + dy * way[1]) / long ** 2, other = this.sides[side ^ 1];
    const low = side % 2 ? other + LEAST_M : this.least[axis], high = side % 2 ? this.most[axis] : other - LEAST_M;
    this.set(side, Math.max(low, Math.min(high, value)));
  }

  draw(pen, camera, width, height) {
    const corner = (bits) => this.inScene([0, 1, 2].map((axis) => this.sides[2 * axis + ((bits >> axis) & 1)]));
    const eye = camera.eye(), ahead = camera.forward(), depth = (place) => place.reduce((sum, one, k) => sum + ahead[k] * (one - eye[k]), 0);
    pen.strokeStyle = COLOUR; pen.lineWidth = 1;
    for (const bits of EDGES) {
      let [a, b] = bits.map(corner);
      if (depth(a) < depth(b)) [a, b] = [b, a];
      if (depth(a) <= NEAR_M) continue;
      // The part of an edge that is before the eye.
      const share = Math.min(1, (depth(a) - NEAR_M) / (depth(a) - depth(b) || 1));
      const ends = [a, a.map((one, k) => one + share * (b[k] - one))].map((end) => camera.project(end, width, height));
      pen.beginPath(); pen.moveTo(...ends[0]); pen.lineTo(...ends[1]); pen.stroke();
    }
    this.sides.forEach((_, side) => {
      const seen = camera.project(this.handle(side), width, height);
      if (!seen) return;
      pen.beginPath(); pen.arc(seen[0], seen[1], side === this.held ? 9 : 7, 0, 7);
      pen.fillStyle = COLOUR; pen.fill(); pen.strokeStyle = "#0d1115"; pen.lineWidth = 2; pen.stroke();
      pen.fillStyle = "#0d1115"; pen.font = "600 10px system-ui"; pen.textAlign = "center"; pen.textBaseline = "middle";
      pen.fillText("xyz"[side >> 1], seen[0], seen[1] + 0.5);
      pen.textAlign = "start"; pen.textBaseline = "alphabetic";
    });
  }
}
