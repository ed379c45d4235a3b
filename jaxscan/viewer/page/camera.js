// Where one looks from: around a target, with z up.
const FOV = (50 * Math.PI) / 180, STEEP = 1.55;

export class Camera {
  constructor() { this.target = [0, 0, 0]; this.yaw = -0.9; this.pitch = 0.55; this.away = 8; this.wide = 10; }

  // Looks at a box from outside, or from above.
  stand(low, high, above = false) {
    this.target = low.map((one, k) => (one + high[k]) / 2);
    this.wide = Math.max(Math.hypot(...low.map((one, k) => high[k] - one)), 0.1);
    this.away = (above ? 0.95 : 0.85) * this.wide;
    this.yaw = above ? -Math.PI / 2 : -0.9; this.pitch = above ? STEEP : 0.55;
  }

  // Stands at a place, and looks along the x axis.
  enter(place) { this.target = [...place]; this.away = 0.05; this.yaw = Math.PI; this.pitch = 0; }

  back() { return [Math.cos(this.pitch) * Math.cos(this.yaw), Math.cos(this.pitch) * Math.sin(this.yaw), Math.sin(this.pitch)]; }
  eye() { const back = this.back(); return this.target.map((one, k) => one + this.away * back[k]); }
  forward() { return this.back().map((one) => -one); }
  right() { return [-Math.sin(this.yaw), Math.cos(this.yaw), 0]; }
  up() { const [x, y, z] = this.right(), [a, b, c] = this.back(); return [b * z - c * y, c * x - a * z, a * y - b * x]; }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.min(STEEP, Math.max(-STEEP, this.pitch + dy));
  }
  // By a share of what is seen.
  move(dx, dy) {
    const right = this.right(), up = this.up(), wide = 2 * Math.tan(FOV / 2) * Math.max(this.away, 0.02 * this.wide);
    this.target = this.target.map((one, k) => one - wide * (dx * right[k] - dy * up[k]));
  }
  zoom(factor) { this.away = Math.min(20 * this.wide, Math.max(0.05, this.away * factor)); }

  focal(height) { return height / (2 * Math.tan(FOV / 2)); }
  halfView(width, height) { return Math.atan(Math.tan(FOV / 2) * Math.hypot(1, width / height)); }

  // From the scene to the picture, in WebGL's order.
  matrix(width, height) {
    const r = this.right(), u = this.up(), b = this.back(), e = this.eye(), f = 1 / Math.tan(FOV / 2), g = (f * height) / width;
    const near = Math.max(0.02, 0.005 * this.away), far = this.away + 4 * this.wide, k = (far + near) / (near - far), w = (2 * far * near) / (near - far);
    const dot = (a) => -(a[0] * e[0] + a[1] * e[1] + a[2] * e[2]);
    const rows = [r, u, b].map((axis) => [...axis, dot(axis)]);
    const m = new Float32Array(16);
    for (let c = 0; c < 4; c++) {
      m[4 * c] = g * rows[0][c]; m[4 * c + 1] = f * rows[1][c];
      m[4 * c + 2] = k * rows[2][c] + (c === 3 ? w : 0); m[4 * c + 3] = -rows[2][c];
    }
    return m;
  }

  // The ray through a place of the picture, in pixels.
  ray(x, y, width, height) {
    const t = Math.tan(FOV / 2), a = ((2 * x) / width - 1) * t * (width / height), b = (1 - (2 * y) / height) * t;
    const r = this.right(), u = this.up(), f = this.forward();
    return { origin: this.eye(), direction: f.map((one, k) => one + a * r[k] + b * u[k]) };
  }

  // Where a place of the scene is in the picture [px]; null behind the camera.
  project(place, width, height) {
    const e = this.eye(), apart = place.map((one, k) => one - e[k]), along = (axis) => axis.reduce((sum, one, k) => sum + one * apart[k], 0);
    const depth = along(this.forward()), focal = this.focal(height);
    return depth <= 0 ? null : [width / 2 + (focal * along(this.right())) / depth, height / 2 - (focal * along(this.up())) / depth];
  }
}
