// What a scene holds, as typed arrays: compressed little-endian numbers in base64, or such an array
// itself.

import { unzlibSync } from "three/examples/jsm/libs/fflate.module.js";

const NONE = 65535;
const STEPS = 65534;

function bytes(text) {
  const binary = atob(text);
  return unzlibSync(Uint8Array.from(binary, (letter) => letter.charCodeAt(0))).slice().buffer;
}

export const whole = (given) => (ArrayBuffer.isView(given) ? given : new Uint32Array(bytes(given)));

// Positions (mm) of quantised points.
export function positions(given, box) {
  if (ArrayBuffer.isView(given)) return given;
  const quantised = new Uint16Array(bytes(given));
  const out = new Float32Array(quantised.length);
  for (let k = 0; k < quantised.length; k++) {
    const low = box.low[k % 3];
    out[k] = low + (quantised[k] / NONE) * (box.high[k % 3] - low);
  }
  return out;
}

// Values of a field; NaN where there is none.
export function values(field) {
  const given = field.values ?? field.times;
  if (ArrayBuffer.isView(given)) return given;
  return Float32Array.from(new Uint16Array(bytes(given)), (q) =>
    q === NONE ? NaN : field.low + (q / STEPS) * (field.high - field.low),
  );
}

// The same of values in a byte each.
export const times = (text, low, high) =>
  Float32Array.from(new Uint8Array(bytes(text)), (q) =>
    q === 255 ? NaN : low + (q / 254) * (high - low),
  );

// Pairs of nodes, from how many before each node its parent stands.
export function segments(text) {
  const pairs = [];
  new Int32Array(bytes(text)).forEach((back, node) => back && pairs.push(node - back, node));
  return Uint32Array.from(pairs);
}

// Potentials (mV) by the names of the leads.
export function potentials(text, leads) {
  const all = Float32Array.from(new Int16Array(bytes(text)), (microvolts) => microvolts / 1000);
  const count = all.length / leads.length;
  return Object.fromEntries(leads.map((name, k) => [name, all.subarray(k * count, (k + 1) * count)]));
}
