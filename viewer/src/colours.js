// Colour maps between a few of their colours. Of those that are even for every kind of colour
// vision (viridis reversed, cividis reversed) early or small is light; of the other, turbo reversed
// without its dark ends, early is red.

import { DataTexture, LinearFilter, RGBAFormat, SRGBColorSpace } from "three";
import { make } from "./controls.js";

export const ZERO = "first ventricular activation"; // of times

const STOPS = {
  time: ["#fde725", "#b5de2b", "#6ece58", "#35b779", "#1f9e89", "#26828e", "#31688e", "#3e4989",
         "#482878", "#440154"],
  scalar: ["#fee838", "#e1cc55", "#c3b369", "#a59c74", "#8a8678", "#70717b", "#575d6d", "#3b496c",
           "#123570", "#00224e"],
  red: ["#c82803", "#f05b12", "#fe992c", "#eccf3a", "#c1f334", "#7cfd5f", "#31f299", "#1bcfd5",
        "#3e9bfe", "#4662d7"],
};

const channel = (hex, at) => parseInt(hex.slice(at, at + 2), 16);

// Red, green and blue (0 to 255) of a share from 0 to 1.
export function colour(kind, share) {
  const stops = STOPS[kind];
  const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const first = Math.min(Math.floor(place), stops.length - 2);
  return [1, 3, 5].map((at) => {
    const a = channel(stops[first], at);
    return a + (place - first) * (channel(stops[first + 1], at) - a);
  });
}

export function texture(kind) {
  const size = 256;
  const data = new Uint8Array(4 * size);
  for (let k = 0; k < size; k++) data.set([...colour(kind, k / (size - 1)), 255], 4 * k);
  const map = new DataTexture(data, size, 1, RGBAFormat);
  map.colorSpace = SRGBColorSpace;
  map.magFilter = map.minFilter = LinearFilter;
  map.needsUpdate = true;
  return map;
}

// The bar below the heart: colours from low to high, with ticks, and what they are.
export class ColourBar {
  constructor() {
    this.canvas = make("canvas", { class: "fv-bar", role: "img" });
    this.text = make("span", {});
  }

  // `colours` are those of the field: its kind, or the map that its times have.
  show(field, colours, ink) {
    const { label, unit, kind, low, high } = field;
    drawBar(this.canvas, { low, high, kind: colours }, ink);
    const zero = kind === "time" ? `; 0: ${ZERO}` : "";
    this.text.textContent = unit === "1" ? label : `${label} (${unit}${zero})`;
    const ends = ticks(low, high);
    this.canvas.setAttribute("aria-label",
      `colours of ${this.text.textContent}, from ${ends[0]} to ${ends.at(-1)}`);
  }
}

function drawBar(canvas, field, ink) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [280, 40];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.clearRect(0, 0, width, height);
  for (let x = 0; x < width - 40; x++) {
    pen.fillStyle = `rgb(${colour(field.kind, x / (width - 41)).map(Math.round).join()})`;
    pen.fillRect(20 + x, 4, 1.5, 12);
  }
  pen.fillStyle = ink;
  pen.font = "12px system-ui, sans-serif";
  pen.textAlign = "center";
  for (const tick of ticks(field.low, field.high)) {
    const x = 20 + ((tick - field.low) / (field.high - field.low)) * (width - 41);
    pen.fillRect(x - 0.5, 16, 1, 4);
    pen.fillText(String(tick), x, 33);
  }
}

// Both ends, and round numbers between them that leave room for their digits.
export function ticks(low, high) {
  const rough = (high - low) / 5;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
  const room = (high - low) / 9;
  const found = [low];
  for (let k = Math.ceil((low + room) / step); k * step <= high - room; k++) found.push(k * step);
  return [...found, high].map((tick) => Number(tick.toPrecision(3)));
}
