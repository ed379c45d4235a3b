// A panorama all around: each pixel of the picture looks along its own ray.
const VERTEX = "attribute vec2 corner; varying vec2 at; void main() { at = corner; gl_Position = vec4(corner, 0.0, 1.0); }";
const FRAGMENT = `precision highp float; varying vec2 at; uniform mat3 turn; uniform vec2 middle, wide, edges; uniform float gain; uniform sampler2D picture;
void main() {
  vec3 ray = normalize(turn * vec3((at - middle) * wide, 1.0));
  float down = (edges.x - asin(clamp(ray.z, -1.0, 1.0))) / (edges.x - edges.y);
  vec2 place = vec2(0.5 - atan(ray.y, ray.x) / 6.28318530718, down);
  gl_FragColor = down < 0.0 || down > 1.0 ? vec4(0.05, 0.067, 0.082, 1.0) : vec4(min(gain * texture2D(picture, place).rgb, 1.0), 1.0);
}`;
// As the colours of clouds are brightened: colours.py.
const WHITE = 235, MOST_GAIN = 6, BRIGHTEST = 0.99, SMALL = [512, 256];

export class Panorama {
  constructor(gl, program) {
    this.gl = gl; this.program = program(VERTEX, FRAGMENT); this.pictures = new Map();
    this.uniform = Object.fromEntries(["turn", "middle", "wide", "edges", "gain"].map((name) => [name, gl.getUniformLocation(this.program, name)]));
    this.corner = gl.getAttribLocation(this.program, "corner");
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
  }

  // The picture of a cloud, once it is there; `loaded` is called then.
  picture(cloud, loaded) {
    if (!this.pictures.has(cloud.number)) {
      this.pictures.set(cloud.number, null);
      const image = new Image();
      image.onload = () => { this.pictures.set(cloud.number, { texture: this.texture(image), gain: this.gain(image) }); loaded(); };
      // Asked for again when one stands there again.
      image.onerror = () => this.pictures.delete(cloud.number);
      image.src = `panorama/${cloud.number}`;
    }
    return this.pictures.get(cloud.number);
  }

  texture(image) {
    const gl = this.gl, made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
    return made;
  }

  // By which a picture becomes so bright that hardly any of it is lost; rooms are dark while they are scanned.
  gain(image) {
    const small = document.createElement("canvas"), pen = small.getContext("2d", { willReadFrequently: true });
    [small.width, small.height] = SMALL;
    pen.drawImage(image, 0, 0, ...SMALL);
    const { data } = pen.getImageData(0, 0, ...SMALL), brightest = new Uint8Array(data.length / 4).map((_, k) => Math.max(...data.subarray(4 * k, 4 * k + 3))).sort();
    return Math.min(MOST_GAIN, Math.max(1, WHITE / Math.max(1, brightest[Math.floor(BRIGHTEST * brightest.length)])));
  }

  // Whether it was drawn.
  draw(cloud, camera, width, height, loaded) {
    const gl = this.gl, picture = this.picture(cloud, loaded);
    if (!picture) return false;
    // Of the view's axes, in those of the scanner: its rows are the axes of the scanner.
    const axes = [camera.right(), camera.up(), camera.forward()];
    const turned = axes.map((axis) => cloud.panorama.axes.map((own) => own.reduce((sum, one, k) => sum + one * axis[k], 0)));
    const focal = camera.focal(width, height), [u, v] = camera.middle(width, height);
    gl.useProgram(this.program); gl.disable(gl.DEPTH_TEST);
    gl.uniformMatrix3fv(this.uniform.turn, false, turned.flat());
    gl.uniform2f(this.uniform.middle, (2 * u) / width - 1, 1 - (2 * v) / height);
    gl.uniform2f(this.uniform.wide, width / (2 * focal), height / (2 * focal));
    gl.uniform1f(this.uniform.gain, picture.gain);
    gl.uniform2f(this.uniform.edges, cloud.panorama.top, cloud.panorama.bottom);
    gl.bindTexture(gl.TEXTURE_2D, picture.texture);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.enableVertexAttribArray(this.corner);
    gl.vertexAttribPointer(this.corner, 2, gl.FLOAT, false, 0, 0);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.enable(gl.DEPTH_TEST);
    return true;
  }
}
