// Leads of an ECG on paper, to scale, with a time cursor.

import { make } from "./controls.js";

const PIXELS_A_MM = 96 / 25.4; // CSS
const SCALES = [ // the first that a window (ms) is short enough for
  { upTo: 400, speed: 100, gain: 20 },
  { upTo: Infinity, speed: 25, gain: 10 },
];
const HEIGHT = 30; // mm of a row, at least
const MARGIN = { top: 9, bottom: 11, left: 12, between: 6, right: 3 }; // mm
const FINE = "#f6d5d2";
const THICK = "#e8a39d";
const INK = "#222222";
const CURSOR = "#0060c0";
const MIN_SIZE = 0.45; // of the scale, before fewer columns are drawn

// The columns of the clinical layout, of as many leads each.
const columnsOf = (leads, columns) => {
  const rows = Math.ceil(leads.length / columns);
  return Array.from({ length: columns }, (_, k) => leads.slice(k * rows, (k + 1) * rows))
    .filter((column) => column.length);
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
    element.replaceChildren(this.canvas);
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
  // zero: what 0 ms is, scale: {speed (mm/s), gain (mm/mV)}}
  show(content) {
    this.content = content;
    const { start, step, traces, leads } = content;
    const each = traces.flatMap(({ values }) => leads.map((lead) => values[lead] ?? []));
    this.end = start + step * (Math.max(2, ...each.map((trace) => trace.length)) - 1);
    this.scale = content.scale ?? SCALES.find(({ upTo }) => this.end - start <= upTo);
    this.low = this.high = 0;
    for (const trace of each) {
      for (const value of trace) {
        if (value < this.low) this.low = value;
        if (value > this.high) this.high = value;
      }
    }
    this.canvas.setAttribute("aria-valuemin", start);
    this.canvas.setAttribute("aria-valuemax", this.end);
    this.draw();
  }

  // Puts the cursor at a time (ms).
  cursor(time) {
    this.time = Math.min(Math.max(time, this.content.start), this.end);
    this.canvas.setAttribute("aria-valuenow", Math.round(this.time));
    this.canvas.setAttribute("aria-valuetext", `${Math.round(this.time)} ms`);
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
    const counts = [4, 2, 1].filter((count) => count <= leads.length);
    const count = counts.find((k) => wide / total(k) >= MIN_SIZE) ?? 1;
    const columns = columnsOf(leads, count);
    const rows = Math.max(...columns.map((column) => column.length));
    const up = Math.ceil(Math.max(this.high * gain, gain) / 5) * 5 + 2;
    const down = Math.ceil(Math.max(-this.low * gain, 5) / 5) * 5;
    const row = Math.max(up + down, HEIGHT * (gain / 20));
    return {
      columns, width, row, up,
      unit: PIXELS_A_MM * Math.min(1, wide / total(count)),
      offsets: columns.map((_, k) => MARGIN.left + k * (width + MARGIN.between)),
      paper: [total(count), MARGIN.top + rows * row + MARGIN.bottom],
    };
  }

  paint() {
    const layout = (this.layout = this.arrange());
    const { unit, paper } = layout;
    if (!(this.element.clientWidth > 0)) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(paper[0] * unit * ratio);
    this.canvas.height = Math.round(paper[1] * unit * ratio);
    this.canvas.style.width = `${paper[0] * unit}px`;
    this.canvas.style.height = `${paper[1] * unit}px`;
    const pen = this.canvas.getContext("2d");
    pen.scale(unit * ratio, unit * ratio); // draws in mm
    this.text = 12 / unit; // of letters, mm
    pen.fillStyle = "#fffdfb";
    pen.fillRect(0, 0, ...paper);
    this.paintGrid(pen, paper, unit * ratio);
    this.paintLabels(pen, layout);
    this.content.traces.forEach((trace) => this.paintTrace(pen, layout, trace));
    if (this.time !== null) this.paintCursor(pen, layout);
  }

  // A line every mm, and a thick one every 5; 0 ms lies on a line of the first column.
  paintGrid(pen, [width, height], pixels) {
    const first = MARGIN.left % 1;
    for (const [step, colour, thick] of [[1, FINE, 1], [5, THICK, 1.4]]) {
      if (step * pixels < 2.5) continue;
      pen.strokeStyle = colour;
      pen.lineWidth = thick / pixels;
      pen.beginPath();
      for (let x = first + (MARGIN.left % step); x <= width; x += step) {
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

  paintLabels(pen, { columns, offsets, width, row, up, paper }) {
    const { start, traces, zero } = this.content;
    const { speed, gain } = this.scale;
    const size = this.text;
    pen.fillStyle = pen.strokeStyle = INK;
    pen.font = `${size}px system-ui, sans-serif`;
    pen.textBaseline = "alphabetic";
    pen.textAlign = "left";
    // which trace is which
    let x = 2;
    for (const { name, colour, dashed } of traces) {
      pen.strokeStyle = colour;
      pen.lineWidth = 0.6;
      pen.setLineDash(dashed ? [1.6, 1.2] : []);
      pen.beginPath();
      pen.moveTo(x, size * 0.9);
      pen.lineTo(x + 7, size * 0.9);
      pen.stroke();
      pen.setLineDash([]);
      pen.fillText(name, x + 8, size * 1.25);
      x += 12 + pen.measureText(name).width;
    }
    // 1 mV for 5 mm, and the leads' names
    pen.strokeStyle = INK;
    pen.lineWidth = 0.4;
    const rows = Math.max(...columns.map((column) => column.length));
    for (let k = 0; k < rows; k++) {
      const zeroLine = MARGIN.top + k * row + up;
      pen.beginPath();
      pen.moveTo(2, zeroLine);
      pen.lineTo(3.5, zeroLine);
      pen.lineTo(3.5, zeroLine - gain);
      pen.lineTo(8.5, zeroLine - gain);
      pen.lineTo(8.5, zeroLine);
      pen.lineTo(10, zeroLine);
      pen.stroke();
    }
    pen.font = `600 ${size}px system-ui, sans-serif`;
    columns.forEach((column, c) =>
      column.forEach((lead, k) => pen.fillText(lead, offsets[c] + 0.5, MARGIN.top + k * row + size)),
    );
    // time, and the scale of paper and voltage
    pen.font = `${size}px system-ui, sans-serif`;
    const length = this.end - start;
    const tick = [20, 50, 100, 200, 500, 1000].find((t) => (t / length) * width > 3.2 * size) ?? 1000;
    pen.textAlign = "center";
    pen.lineWidth = 0.3;
    for (const left of offsets) {
      for (let t = Math.ceil(start / tick) * tick; t <= this.end; t += tick) {
        const at = left + ((t - start) / length) * width;
        pen.fillRect(at - 0.15, paper[1] - MARGIN.bottom, 0.3, 1.2);
        pen.fillText(String(t), at, paper[1] - MARGIN.bottom + 1.2 + size);
      }
    }
    pen.textAlign = "left";
    const said = `${speed} mm/s, ${gain} mm/mV; time (ms${zero ? `; 0: ${zero}` : ""})`;
    pen.fillText(said, 2, paper[1] - size * 0.4);
  }

  paintTrace(pen, { columns, offsets, width, row, up }, { values, colour, dashed }) {
    const { start, step } = this.content;
    const across = (width / (this.end - start)) * step;
    pen.strokeStyle = colour;
    pen.lineWidth = Math.min(0.5, this.text * 0.14);
    pen.lineJoin = "round";
    pen.setLineDash(dashed ? [1.6, 1.2] : []);
    columns.forEach((column, c) =>
      column.forEach((lead, k) => {
        const zero = MARGIN.top + k * row + up;
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

  paintCursor(pen, { columns, offsets, width, row }) {
    const share = (this.time - this.content.start) / (this.end - this.content.start);
    const said = `${Math.round(this.time)} ms`;
    pen.fillStyle = CURSOR;
    pen.font = `600 ${this.text}px system-ui, sans-serif`;
    columns.forEach((column, c) => {
      const x = offsets[c] + share * width;
      pen.fillRect(x - 0.15, MARGIN.top - 1, 0.3, column.length * row + 1);
      pen.textAlign = share > 0.7 ? "right" : "left";
      pen.fillText(said, x + (share > 0.7 ? -0.8 : 0.8), MARGIN.top);
    });
  }

  dispose() {
    cancelAnimationFrame(this.pending);
    this.observer.disconnect();
    this.canvas.remove();
  }
}
