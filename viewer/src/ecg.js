// Leads of an ECG on paper, to scale, with a time cursor.

import { make } from "./controls.js";

const PIXELS_A_MM = 96 / 25.4; // CSS
const SPEEDS = [[400, 100], [Infinity, 25]]; // windows (ms) up to which length have which mm/s
const GAIN = 10; // mm/mV
const ENLARGED = 20; // the same of a short window that spans at most HIGH mV
const HIGH = 2.5;
const MARGIN = { top: 4, bottom: 6, left: 12, between: 6, right: 3 }; // mm
const PAPER = "#fffdfb";
const FINE = "#f6d5d2";
const THICK = "#e8a39d";
const INK = "#222222";
const CURSOR = "#0060c0";
const SMALLEST = 0.45; // of the scale, before fewer columns are drawn

// Columns of leads: limb over chest leads, or in threes or sixes as on paper.
function columnsOf(leads, count) {
  const rows = Math.ceil(leads.length / count);
  return Array.from({ length: count }, (_, k) =>
    count === 6 ? leads.filter((_, n) => n % 6 === k) : leads.slice(k * rows, (k + 1) * rows),
  ).filter((column) => column.length);
}

// A trace in the legend.
const entry = ({ name, colour, dashed }) => {
  const line = `border-top: 2px ${dashed ? "dashed" : "solid"} ${colour}`;
  const swatch = make("span", { style: `${line}; width: 1.6em; margin-right: .4em` });
  return make("span", { style: "display: inline-flex; align-items: center" }, swatch, name);
};

export class EcgPaper {
  constructor(element) {
    this.onCursor = null; // (ms) => {}
    this.time = null;
    this.canvas = make("canvas", {
      tabindex: 0, role: "slider", "aria-label": "time in the ECG (ms); use the arrow keys",
      style: "display: block; touch-action: pan-y; cursor: ew-resize",
    });
    this.element = element;
    const row = "display: flex; flex-wrap: wrap; gap: .2rem 1rem; padding: .2rem .4rem";
    this.legend = make("div", { style: row });
    this.note = make("div", { style: row });
    this.sheet = make(
      "div", { style: `background: ${PAPER}; color: ${INK}; font-size: 13px; width: fit-content;
        max-width: 100%; color-scheme: light; print-color-adjust: exact` },
      this.legend, this.canvas, this.note,
    );
    element.replaceChildren(this.sheet);
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(element);
    let held = false;
    this.canvas.addEventListener("pointerdown", (event) => {
      held = true;
      this.canvas.setPointerCapture(event.pointerId);
      this.point(event);
    });
    this.canvas.addEventListener("pointermove", (event) => held && this.point(event));
    for (const kind of ["pointerup", "pointercancel"]) {
      this.canvas.addEventListener(kind, () => (held = false));
    }
    this.canvas.addEventListener("keydown", (event) => this.byKey(event));
  }

  // {leads: ["I", …], start, step (ms), traces: [{name, colour, dashed, values: {lead: mV}}],
  // zero: what 0 ms is}
  show(content) {
    this.content = content;
    const { start, step, traces, leads, zero } = content;
    const each = traces.flatMap(({ values }) => leads.map((lead) => values[lead] ?? []));
    this.end = start + step * (Math.max(2, ...each.map((trace) => trace.length)) - 1);
    const speed = SPEEDS.find(([upTo]) => this.end - start <= upTo)[1];
    this.range = {}; // of each lead (mV)
    for (const lead of leads) {
      const range = (this.range[lead] = [0, 0]);
      for (const { values } of traces) {
        for (const value of values[lead] ?? []) {
          if (value < range[0]) range[0] = value;
          if (value > range[1]) range[1] = value;
        }
      }
    }
    const highest = Math.max(...Object.values(this.range).map(([low, high]) => high - low));
    this.scale = content.scale ?? { speed, gain: speed > 25 && highest <= HIGH ? ENLARGED : GAIN };
    this.now = make("b", { style: `color: ${CURSOR}; margin-left: auto` });
    this.legend.replaceChildren(...traces.map(entry), this.now);
    const said = `${this.scale.speed} mm/s, ${this.scale.gain} mm/mV; time in ms`;
    this.note.textContent = zero ? `${said}, 0: ${zero}` : said;
    this.canvas.setAttribute("aria-valuemin", start);
    this.canvas.setAttribute("aria-valuemax", this.end);
    this.draw();
  }

  // Puts the cursor at a time (ms).
  cursor(time) {
    this.time = Math.min(Math.max(time, this.content.start), this.end);
    this.canvas.setAttribute("aria-valuenow", Math.round(this.time));
    const said = this.time < this.end ? `${Math.round(this.time)} ms` : ""; // all is shown at the end
    this.now.textContent = said;
    this.canvas.setAttribute("aria-valuetext", said || "whole beat");
    this.draw();
  }

  move(time) {
    this.cursor(time);
    this.onCursor?.(this.time);
  }

  point(event) {
    if (!this.content || !this.layout) return;
    const area = this.canvas.getBoundingClientRect();
    const { unit, offsets, width } = this.layout;
    const x = (event.clientX - area.left) / unit;
    // of the column that is nearest
    const away = (left) => Math.max(left - x, x - left - width, 0);
    const left = offsets.reduce((a, b) => (away(b) < away(a) ? b : a));
    this.move(this.content.start + ((x - left) / width) * (this.end - this.content.start));
  }

  byKey(event) {
    if (!this.content) return;
    const { start } = this.content;
    const now = this.time ?? start;
    const to = {
      ArrowLeft: now - 1, ArrowRight: now + 1, ArrowDown: now - 1, ArrowUp: now + 1,
      PageDown: now - 10, PageUp: now + 10, Home: start, End: this.end,
    }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    this.move(Math.round(to));
  }

  draw() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      if (this.content) this.paint();
    });
  }

  // Lays the columns out in mm of paper: as many as fit, and then to scale on the screen, or smaller.
  arrange() {
    const { leads, start } = this.content;
    const { speed, gain } = this.scale;
    const width = ((this.end - start) / 1000) * speed;
    const wide = this.element.clientWidth / PIXELS_A_MM;
    const total = (count) =>
      MARGIN.left + count * width + (count - 1) * MARGIN.between + MARGIN.right;
    const fits = (count) => count <= leads.length && wide / total(count) >= (count > 4 ? 1 : SMALLEST);
    const columns = columnsOf(leads, [6, 4, 2].find(fits) ?? 1);
    // a row is as high as its leads need, in whole boxes
    const zeros = [];
    let below = MARGIN.top;
    for (let k = 0; k < columns[0].length; k++) {
      const ranges = columns.flatMap((column) => (column[k] ? [this.range[column[k]]] : []));
      const up = Math.max(gain, ...ranges.map(([, high]) => high * gain));
      const down = Math.max(2, ...ranges.map(([low]) => -low * gain));
      zeros.push(below + 5 * Math.ceil((up + 2) / 5));
      below = zeros[k] + 5 * Math.ceil((down + 1) / 5);
    }
    return {
      columns, width, zeros, bottom: below,
      unit: PIXELS_A_MM * Math.min(1, wide / total(columns.length)),
      offsets: columns.map((_, k) => MARGIN.left + k * (width + MARGIN.between)),
      paper: [total(columns.length), below + MARGIN.bottom],
    };
  }

  paint() {
    if (!(this.element.clientWidth > 0)) return;
    const layout = (this.layout = this.arrange());
    const { unit, paper } = layout;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(paper[0] * unit * ratio);
    this.canvas.height = Math.round(paper[1] * unit * ratio);
    this.canvas.style.width = `${paper[0] * unit}px`;
    this.canvas.style.height = `${paper[1] * unit}px`;
    const pen = this.canvas.getContext("2d", { willReadFrequently: true });
    pen.scale(unit * ratio, unit * ratio); // draws in mm
    this.text = 12 / unit; // of letters, mm
    pen.fillStyle = PAPER;
    pen.fillRect(0, 0, ...paper);
    this.paintGrid(pen, paper, unit * ratio);
    this.paintLabels(pen, layout);
    this.content.traces.forEach((trace) => this.paintTrace(pen, layout, trace));
    if (this.time !== null && this.time < this.end) this.paintCursor(pen, layout);
  }

  // A line every mm, and a thick one every 5; 0 ms lies on a line of the first column.
  paintGrid(pen, [width, height], pixels) {
    for (const [step, colour, thick] of [[1, FINE, 1], [5, THICK, 1.4]]) {
      if (step * pixels < 2.5) continue;
      pen.strokeStyle = colour;
      pen.lineWidth = thick / pixels;
      pen.beginPath();
      for (let x = MARGIN.left % step; x <= width; x += step) {
        pen.moveTo(x, 0);
        pen.lineTo(x, height);
      }
      for (let y = MARGIN.top % step; y <= height; y += step) {
        pen.moveTo(0, y);
        pen.lineTo(width, y);
      }
      pen.stroke();
    }
  }

  // The calibration mark (1 mV for 5 mm), the leads' names, and times.
  paintLabels(pen, { columns, offsets, width, zeros, bottom }) {
    const { gain } = this.scale;
    const size = this.text;
    pen.fillStyle = pen.strokeStyle = INK;
    pen.lineWidth = 0.4;
    for (const zero of zeros) {
      pen.beginPath();
      [[2, 0], [3.5, 0], [3.5, gain], [8.5, gain], [8.5, 0], [10, 0]].forEach(([x, up]) =>
        pen.lineTo(x, zero - up),
      );
      pen.stroke();
    }
    pen.textAlign = "left";
    pen.font = `600 ${size}px system-ui, sans-serif`;
    columns.forEach((column, c) =>
      column.forEach((lead, k) => pen.fillText(lead, offsets[c], zeros[k] - gain - 0.5)),
    );
    pen.font = `${size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    const { start } = this.content;
    const length = this.end - start;
    const wide = (t) => (t / length) * width > 2.2 * size;
    const tick = [20, 50, 100, 200, 500].find(wide) ?? 1000;
    for (const left of offsets) {
      for (let t = Math.ceil(start / tick) * tick; t <= this.end; t += tick) {
        const at = left + ((t - start) / length) * width;
        pen.fillRect(at - 0.15, bottom, 0.3, 1.2);
        pen.fillText(String(t), at, bottom + 1.2 + size);
      }
    }
  }

  paintTrace(pen, { columns, offsets, width, zeros }, { values, colour, dashed }) {
    const { start, step } = this.content;
    const across = (width / (this.end - start)) * step;
    pen.strokeStyle = colour;
    pen.lineWidth = Math.min(0.5, this.text * 0.14);
    pen.lineJoin = "round";
    pen.setLineDash(dashed ? [1.6, 1.2] : []);
    columns.forEach((column, c) =>
      column.forEach((lead, k) => {
        const zero = zeros[k];
        let drawn = false;
        pen.beginPath();
        (values[lead] ?? []).forEach((value, n) => {
          if (Number.isNaN(value)) return (drawn = false);
          const place = [offsets[c] + n * across, zero - value * this.scale.gain];
          if (drawn) pen.lineTo(...place);
          else pen.moveTo(...place);
          drawn = true;
        });
        pen.stroke();
      }),
    );
    pen.setLineDash([]);
  }

  paintCursor(pen, { offsets, width, bottom }) {
    const share = (this.time - this.content.start) / (this.end - this.content.start);
    pen.fillStyle = CURSOR;
    for (const left of offsets) pen.fillRect(left + share * width - 0.2, 1, 0.4, bottom - 1);
  }

  dispose() {
    cancelAnimationFrame(this.pending);
    this.observer.disconnect();
    this.sheet.remove();
  }
}
