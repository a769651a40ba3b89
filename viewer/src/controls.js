// The controls around the picture, as plain elements; every text is inserted as text.

const STYLE = `
.fv { position: relative; color: var(--fg, CanvasText); }
.fv-both, .fv-pictures { display: flex; flex-wrap: wrap; gap: .5rem; align-items: flex-start; }
.fv-left { flex: 1 1 26rem; min-width: 0; }
.fv-two .fv-left, .fv-two .fv-ecg { flex-basis: 100%; }
.fv-panel { flex: 1 1 20rem; min-width: 0; }
.fv-title { display: none; text-align: center; font-weight: 600; }
.fv-two .fv-title { display: block; }
.fv-picture { position: relative; width: 100%; aspect-ratio: 4 / 3; max-height: 60vh;
  touch-action: none; }
.fv-picture .fv-over { position: absolute; inset: 0; pointer-events: none; }
.fv-clock { font-variant-numeric: tabular-nums; }
.fv-long { flex: 1 1 12rem; }
.fv-ecg { flex: 0 1 33rem; min-width: 0; overflow: hidden; }
@media (max-width: 58rem) {
  .fv-left { display: contents; }
  .fv-ecg { flex-basis: 100%; order: 1; }
  .fv-pictures { flex-basis: 100%; }
  .fv-left > .fv-row { order: 2; }
}
.fv-picture canvas, .fv-picture img { width: 100%; height: 100%; display: block; }
.fv-row { display: flex; flex-wrap: wrap; gap: .5rem 1rem; align-items: center; margin: .5rem 0; }
.fv label { display: inline-flex; gap: .4rem; align-items: center; max-width: 100%; }
.fv select { font: inherit; color: inherit; background: var(--bg, Canvas); max-width: 100%;
  min-width: 0; border: 1px solid var(--line, #888); padding: .15rem .3rem; }
.fv button { font: inherit; color: inherit; background: var(--bg, Canvas); cursor: pointer;
  border: 1px solid var(--line, #888); padding: .15rem .6rem; border-radius: .2rem; }
.fv input[type=range] { flex: 1 1 8rem; min-width: 6rem; accent-color: var(--accent, #b34700); }
.fv input[type=checkbox] { accent-color: var(--accent, #b34700); }
.fv :focus-visible { outline: 2px solid var(--accent, #b34700); outline-offset: 1px; }
.fv-bar { width: 280px; max-width: 100%; height: 40px; }
.fv-read { min-height: 1.5em; }
@media print { .fv-title { display: block; } .fv-row:not(.fv-keep) { display: none; } }
`;

export function addStyle() {
  if (document.getElementById("fv-style")) return;
  const style = document.createElement("style");
  style.id = "fv-style";
  style.textContent = STYLE;
  document.head.append(style);
}

export function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export function choice(label, names, changed) {
  const select = make("select", { "aria-label": label });
  names.forEach((name, k) => select.append(make("option", { value: k }, name)));
  select.addEventListener("change", () => changed(Number(select.value)));
  return { select, row: make("label", {}, label, select) };
}

export function button(text, label, pressed) {
  const made = make("button", { type: "button", "aria-label": label }, text);
  made.addEventListener("click", pressed);
  return made;
}

export function check(label, checked, changed) {
  const box = make("input", { type: "checkbox" });
  box.checked = checked;
  box.addEventListener("change", changed);
  return { box, row: make("label", {}, box, label) };
}

// Whether the browser can draw a heart; else the element says that it cannot.
export function hasWebGL(element) {
  if (document.createElement("canvas").getContext("webgl2")) return true;
  element.textContent = "This browser has no WebGL, which the heart is drawn with.";
  return false;
}
