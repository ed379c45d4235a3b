// Where one looks from: around a target, with z up; or from a place at which one stands.
const rad = Math.PI / 180, FOV = 50 * rad, NARROWEST = 15 * rad, WIDEST = 90 * rad, STEEP = 1.55, PER_PX = 1 / 200;
export const OUTSIDE = { yaw: -0.9, pitch: 0.55 };
const ABOVE = { yaw: -Math.PI / 2, pitch: STEEP }, dot = (a, b) => a.reduce((sum, one, k) => sum + one * b[k], 0);

export class Camera {
  constructor() {
    Object.assign(this, { target: [0, 0, 0], away: 8, wide: 10, fov: FOV, standing: false, ...OUTSIDE });
    // Shares of the picture that the panel covers at the right and at the bottom; width by height of what is left.
    this.beside = 0; this.below = 0; this.aspect = 1;
  }

  // Takes the part of the picture that the panel leaves free.
  fit(width, height, right, below) { this.beside = right; this.below = below; this.aspect = ((1 - right) * width) / ((1 - below) * height); }

  // Looks at a box from outside, so that balls in it, [centre, radius], fill what is free.
  stand(low, high, balls) { this.enclose(low, high, balls, OUTSIDE); }

  // Looks at it from above along walls that are turned by an angle, the longer ones across the picture where it is wide.
  above(low, high, balls, walls) {
    const ways = [0, 1].map((quarters) => ({ ...ABOVE, yaw: ABOVE.yaw + walls + (quarters * Math.PI) / 2 }));
    const away = ways.map((way) => { this.enclose(low, high, balls, way); return this.away; });
    if (away[0] <= away[1]) this.enclose(low, high, balls, ways[0]);
  }

  enclose(low, high, balls, way) {
    this.target = low.map((one, k) => (one + high[k]) / 2);
    this.wide = Math.max(Math.hypot(...low.map((one, k) => high[k] - one)), 0.1);
    Object.assign(this, { standing: false, fov: FOV }, way);
    const tall = Math.tan(FOV / 2) * Math.max(1, 1 / this.aspect), broad = Math.tan(FOV / 2) * Math.max(1, this.aspect);
    const reach = (centre, radius, axis) => Math.abs(dot(centre, axis)) + radius, [right, up, back] = [this.right(), this.up(), this.back()];
    this.away = Math.max(0.05, ...balls.map(([place, radius]) => {
      const centre = place.map((one, k) => one - this.target[k]);
      return dot(centre, back) + Math.max(reach(centre, radius, right) / broad, reach(centre, radius, up) / tall);
    }));
  }

  // Stands at a place, and looks along the x axis.
  enter(place) { Object.assign(this, { target: [...place], away: 0, yaw: Math.PI, pitch: 0, standing: true, fov: FOV }); }

  // Turns about a place from now on.
  about(place) {
    if (this.standing) Object.assign(this, { standing: false, fov: FOV, away: Math.hypot(...place.map((one, k) => one - this.target[k])) });
    this.target = [...place];
  }

  back() { return [Math.cos(this.pitch) * Math.cos(this.yaw), Math.cos(this.pitch) * Math.sin(this.yaw), Math.sin(this.pitch)]; }
  eye() { const back = this.back(); return this.target.map((one, k) => one + this.away * back[k]); }
  forward() { return this.back().map((one) => -one); }
  right() { return [-Math.sin(this.yaw), Math.cos(this.yaw), 0]; }
  up() { const [x, y, z] = this.right(), [a, b, c] = this.back(); return [b * z - c * y, c * x - a * z, a * y - b * x]; }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.min(STEEP, Math.max(-STEEP, this.pitch + dy));
  }
  // A pointer's way, in pixels: it turns what is looked at; where one stands the picture goes with the pointer.
  drag(dx, dy, width, height) {
    const focal = this.focal(width, height);
    if (this.standing) this.turn(-dx / focal, -dy / focal); else this.turn(dx * PER_PX, dy * PER_PX);
  }
  // Moves the picture by pixels, as far as it is away.
  move(dx, dy, width, height) {
    const right = this.right(), up = this.up(), each = Math.max(this.away, (this.standing ? 0.2 : 0.02) * this.wide) / this.focal(width, height);
    this.target = this.target.map((one, k) => one - each * (dx * right[k] - dy * up[k]));
  }
  // Comes nearer, or looks closer where one stands.
  zoom(factor) {
    if (this.standing) this.fov = Math.min(WIDEST, Math.max(NARROWEST, this.fov * factor));
    else this.away = Math.min(20 * this.wide, Math.max(0.05, this.away * factor));
  }

  // In pixels, by the shorter side of what is free.
  focal(width, height) { return Math.min((1 - this.beside) * width, (1 - this.below) * height) / (2 * Math.tan(this.fov / 2)); }
  // The middle of what is free.
  middle(width, height) { return [((1 - this.beside) * width) / 2, ((1 - this.below) * height) / 2]; }
  // The angle from the middle to the farthest corner of the picture.
  halfView(width, height) { return Math.atan(Math.hypot((1 + this.beside) * width, (1 + this.below) * height) / 2 / this.focal(width, height)); }

  // By which WebGL's depths are metres: [k, w], a depth d of -1 to 1 is w / (d + k).
  depths() {
    const near = Math.max(0.02, 0.005 * this.away), far = this.away + 4 * this.wide;
    return [(far + near) / (near - far), (2 * far * near) / (near - far)];
  }

  // From the scene to the picture, in WebGL's order.
  matrix(width, height) {
    const r = this.right(), u = this.up(), b = this.back(), e = this.eye(), focal = this.focal(width, height), f = (2 * focal) / height, g = (2 * focal) / width;
    const [k, w] = this.depths();
    const rows = [r, u, b].map((axis) => [...axis, -dot(axis, e)]);
    const m = new Float32Array(16);
    for (let c = 0; c < 4; c++) {
      m[4 * c] = g * rows[0][c] + this.beside * rows[2][c]; m[4 * c + 1] = f * rows[1][c] - this.below * rows[2][c];
      m[4 * c + 2] = k * rows[2][c] + (c === 3 ? w : 0); m[4 * c + 3] = -rows[2][c];
    }
    return m;
  }

  // The ray through a place of the picture, in pixels.
  ray(x, y, width, height) {
    const focal = this.focal(width, height), [u0, v0] = this.middle(width, height), a = (x - u0) / focal, b = (v0 - y) / focal;
    const r = this.right(), u = this.up(), f = this.forward();
    return { origin: this.eye(), direction: f.map((one, k) => one + a * r[k] + b * u[k]) };
  }

  // Where a place of the scene is in the picture [px]; null behind the camera.
  project(place, width, height) {
    const e = this.eye(), apart = place.map((one, k) => one - e[k]), depth = dot(apart, this.forward()), focal = this.focal(width, height);
    const [u0, v0] = this.middle(width, height);
    return depth <= 0 ? null : [u0 + (focal * dot(apart, this.right())) / depth, v0 - (focal * dot(apart, this.up())) / depth];
  }
}
