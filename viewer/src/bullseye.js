// Values of the left ventricle's 17 segments, seen from the apex: anterior up, the septum to the left.

import { colour } from "./colours.js";
import { make } from "./controls.js";

const SIZE = 342; // pixels
const RING = 38;
const WALLS = [["anterior", 0, -1], ["septal", -1, 0], ["inferior", 0, 1], ["lateral", 1, 0]];

const written = (value, { unit }) => value.toFixed(unit === "1" ? 2 : 0);

export class BullsEye {
  constructor() {
    this.title = make("div", { class: "fv-title" });
    this.canvas = make("canvas", { role: "img", style: "width: 100%" });
    this.root = make("div", { style: `width: min(${SIZE}px, 100%)` }, this.title, this.canvas);
  }

  // Segments {values, low, high} (17 each; low and high are an interval, or missing) in the colours
  // of a field {kind, low, high, label}; `ink` is the colour of what is written outside.
  show({ values, low, high }, field, title, ink) {
    this.title.textContent = title;
    const numbers = values.map((value) => (value === null ? "none" : written(value, field)));
    this.canvas.setAttribute("aria-label", `17 segments: ${field.label}, ${title}: ${numbers.join(", ")}`);
    this.canvas.title = `${field.label}, of each segment's mean${low ? "; below it, 90% interval" : ""}`;
    const ratio = Math.min(devicePixelRatio, 2);
    this.canvas.width = this.canvas.height = SIZE * ratio;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.translate(SIZE / 2, SIZE / 2);
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    let number = 0;
    for (const [ring, count] of [[4, 6], [3, 6], [2, 4], [1, 1]]) {
      for (let sector = 0; sector < count; sector += 1) {
        const middle = -Math.PI / 2 - (2 * Math.PI * sector) / count;
        this.segment(pen, ring, middle, Math.PI / count, field, values[number],
          (low?.[number] ?? null) !== null && [low[number], high[number]]);
        number += 1;
      }
    }
    pen.fillStyle = ink;
    pen.font = "12px system-ui, sans-serif";
    for (const [wall, x, y] of WALLS) {
      pen.save();
      pen.translate(x * (4 * RING + 9), y * (4 * RING + 9));
      pen.rotate((x * Math.PI) / 2);
      pen.fillText(wall, 0, 0);
      pen.restore();
    }
  }

  segment(pen, ring, middle, half, field, value, interval) {
    if (value === null) return; // never activated
    const inner = ring === 1 ? 0 : (ring - 1) * RING;
    const rgb = colour(field.kind, (value - field.low) / (field.high - field.low));
    pen.fillStyle = `rgb(${rgb.map(Math.round).join()})`;
    pen.strokeStyle = "#fff";
    pen.beginPath();
    pen.arc(0, 0, ring * RING, middle - half, middle + half);
    pen.arc(0, 0, inner, middle + half, middle - half, true);
    pen.fill();
    if (ring > 1) pen.stroke();
    const away = ring === 1 ? 0 : (ring - 0.5) * RING;
    const [x, y] = [away * Math.cos(middle), away * Math.sin(middle)];
    pen.fillStyle = 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2] < 128 ? "#fff" : "#000";
    pen.font = "600 12px system-ui, sans-serif";
    pen.fillText(written(value, field), x, interval ? y - 5 : y);
    if (!interval) return;
    pen.font = "9px system-ui, sans-serif";
    pen.fillText(interval.map((end) => written(end, field)).join("–"), x, y + 6);
  }
}
