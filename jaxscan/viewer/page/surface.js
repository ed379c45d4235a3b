// The surface between the points: triangles that the server joins on the cloud's grid, lit from where one looks.
const VERTEX = `attribute vec3 place, colour, side; uniform mat4 view; uniform vec3 shift, eye; uniform vec2 turn; varying vec3 shown, turned, normal, towards;
void main() {
  vec3 at = place + shift;
  turned = vec3(turn.x * at.x + turn.y * at.y, turn.x * at.y - turn.y * at.x, at.z);
  gl_Position = view * vec4(at, 1.0); shown = colour; normal = side; towards = eye - at;
}`;
const FRAGMENT = `precision highp float; varying vec3 shown, turned, normal, towards; uniform vec3 low, high;
void main() {
  if (any(lessThan(turned, low)) || any(greaterThan(turned, high))) discard;
  float light = length(normal) < 0.1 ? 1.0 : abs(dot(normalize(normal), normalize(towards)));
  gl_FragColor = vec4(shown * (0.45 + 0.55 * light), 1.0);
}`;
const PLAIN = [0.45, 0.45, 0.45];

export class Surfaces {
  constructor(gl, program) {
    this.gl = gl; this.made = new Map();
    // Nearly all have it; a surface of more than 65536 corners is not drawn without.
    this.works = Boolean(gl.getExtension("OES_element_index_uint"));
    this.program = program(VERTEX, FRAGMENT);
    this.at = Object.fromEntries(["place", "colour", "side"].map((name) => [name, gl.getAttribLocation(this.program, name)]));
    this.uniform = Object.fromEntries(["view", "shift", "eye", "turn", "low", "high"].map((name) => [name, gl.getUniformLocation(this.program, name)]));
  }

  // Fetches the surface of a cloud; returns why it cannot.
  async load(cloud) {
    if (this.made.has(cloud.number)) return "";
    const answer = await fetch(`surface/${cloud.number}`).catch(() => null);
    if (!answer?.ok) return answer ? (await answer.text()).trim() : "No connection to jaxscan view.";
    const data = await answer.arrayBuffer(), [corners, faces] = new Uint32Array(data, 0, 2), gl = this.gl;
    const buffer = (kind, start, bytes) => {
      const made = gl.createBuffer();
      gl.bindBuffer(kind, made); gl.bufferData(kind, new Uint8Array(data, start, bytes), gl.STATIC_DRAW);
      return made;
    };
    this.made.set(cloud.number, {
      corners, count: 3 * faces, version: -1, colour: null,
      place: buffer(gl.ARRAY_BUFFER, 8, 12 * corners), side: buffer(gl.ARRAY_BUFFER, 8 + 12 * corners, 4 * corners),
      faces: buffer(gl.ELEMENT_ARRAY_BUFFER, 8 + 16 * corners, 12 * faces),
    });
    return "";
  }

  // Colours of the present kind, for those whose colours are others; `done` is called when some have come.
  async recolour(query, version, done) {
    for (const [number, one] of this.made) {
      if (one.version === version || one.asked === version) continue;
      one.asked = version;
      const answer = await fetch(`surface-colours/${number}?${query}`).catch(() => null);
      if (!answer?.ok) { one.asked = -1; continue; }
      const data = await answer.arrayBuffer(), gl = this.gl;
      if (one.asked !== version) continue;
      one.colour ??= gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, one.colour); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      one.version = version;
      done();
    }
  }

  // Draws that of a cloud; returns how many points it has.
  draw(cloud, { matrix, eye, section: [low, high], turn, backs, version }) {
    const gl = this.gl, one = this.made.get(cloud.number), { at, uniform } = this;
    gl.useProgram(this.program);
    gl.uniformMatrix4fv(uniform.view, false, matrix); gl.uniform3fv(uniform.shift, cloud.shift); gl.uniform3fv(uniform.eye, eye);
    gl.uniform3fv(uniform.low, low); gl.uniform3fv(uniform.high, high); gl.uniform2f(uniform.turn, Math.cos(turn), Math.sin(turn));
    if (!backs) gl.enable(gl.CULL_FACE);
    const bind = (place, buffer, size, type, scaled, stride) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.enableVertexAttribArray(place); gl.vertexAttribPointer(place, size, type, scaled, stride, 0);
    };
    bind(at.place, one.place, 3, gl.FLOAT, false, 0); bind(at.side, one.side, 3, gl.BYTE, true, 4);
    if (one.version === version) bind(at.colour, one.colour, 3, gl.UNSIGNED_BYTE, true, 0);
    else { gl.disableVertexAttribArray(at.colour); gl.vertexAttrib3f(at.colour, ...PLAIN); }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, one.faces);
    gl.drawElements(gl.TRIANGLES, one.count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.CULL_FACE);
    for (const place of Object.values(at)) gl.disableVertexAttribArray(place);
    return one.corners;
  }
}
