// Eye-dome lighting (Boucheny, 2009): a pixel is the darker the farther it lies behind its neighbours, so that edges stand out.
const VERTEX = "attribute vec2 corner; varying vec2 at; void main() { at = 0.5 * corner + 0.5; gl_Position = vec4(corner, 0.0, 1.0); }";
// `range` takes depths as WebGL stores them back to metres: camera.js.
const FRAGMENT = `precision highp float; varying vec2 at; uniform sampler2D picture, depth; uniform vec2 pixel, range;
float away(vec2 place) { return log2(range.y / (2.0 * texture2D(depth, place).r - 1.0 + range.x)); }
void main() {
  vec4 seen = texture2D(picture, at);
  if (texture2D(depth, at).r == 1.0) { gl_FragColor = seen; return; }
  float own = away(at), behind = 0.0;
  for (int k = 0; k < 8; k++) {
    float turn = 0.785398 * float(k);
    behind += max(0.0, own - away(at + pixel * vec2(cos(turn), sin(turn))));
  }
  gl_FragColor = vec4(seen.rgb * exp(-5.0 * behind), 1.0);
}`;
const REACH_PX = 1.4;

export class Shading {
  constructor(gl, program) {
    this.gl = gl;
    // Without it depths cannot be read, and there is no shading.
    this.works = Boolean(gl.getExtension("WEBGL_depth_texture"));
    if (!this.works) return;
    this.program = program(VERTEX, FRAGMENT);
    this.uniform = Object.fromEntries(["picture", "depth", "pixel", "range"].map((name) => [name, gl.getUniformLocation(this.program, name)]));
    this.corner = gl.getAttribLocation(this.program, "corner");
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    this.frame = gl.createFramebuffer(); this.picture = gl.createTexture(); this.depth = gl.createTexture(); this.size = [0, 0];
  }

  // What is drawn from now on is shaded by `end`.
  begin(width, height, dense) {
    const gl = this.gl;
    this.dense = dense;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    if (this.size[0] === width && this.size[1] === height) return;
    this.size = [width, height];
    this.hold(this.picture, gl.RGBA, gl.UNSIGNED_BYTE, gl.COLOR_ATTACHMENT0);
    this.hold(this.depth, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, gl.DEPTH_ATTACHMENT);
  }

  hold(texture, format, type, part) {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, ...this.size, 0, format, type, null);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, part, gl.TEXTURE_2D, texture, 0);
  }

  end(range) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(this.program); gl.disable(gl.DEPTH_TEST);
    for (const [unit, texture] of [this.picture, this.depth].entries()) { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, texture); }
    gl.uniform1i(this.uniform.picture, 0); gl.uniform1i(this.uniform.depth, 1);
    gl.uniform2f(this.uniform.pixel, ...this.size.map((one) => (REACH_PX * this.dense) / one)); gl.uniform2f(this.uniform.range, ...range);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.enableVertexAttribArray(this.corner); gl.vertexAttribPointer(this.corner, 2, gl.FLOAT, false, 0, 0);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    // A texture that is drawn into must not be one that can be read.
    for (const unit of [1, 0]) { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, null); }
    gl.enable(gl.DEPTH_TEST);
  }
}
