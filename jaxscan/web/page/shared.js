// What all pages share. All text of elements is text, never markup.
export const at = (id) => document.getElementById(id);

export function fill(list, items) { list.replaceChildren(...items); }

export function make(tag, text = "", kind = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

export function compiled(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}

// A page's own name, kept over a reload, so that it is the same page afterwards.
export function ownName() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  const name = sessionStorage.getItem("page") ?? Array.from(bytes, (b) => b.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem("page", name);
  return name;
}

// Why the server does not let this page in, "" where it does, or is not there.
// One that began anew has another token: who opens its address in another tab brings this page back, too.
export async function refusal() {
  const asked = await fetch("icon.svg", { cache: "no-store" }).catch(() => null);
  return asked?.status === 403 ? asked.text() : "";
}
