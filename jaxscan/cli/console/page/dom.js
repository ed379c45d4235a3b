// Makes elements; all text is text, never markup.
export const at = (id) => document.getElementById(id);

export function fill(list, items) { list.replaceChildren(...items); }

export function make(tag, text = "", kind = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}
