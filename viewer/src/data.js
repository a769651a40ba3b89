// What a scene holds, as typed arrays: base64 of little-endian numbers, or such an array itself.

const NONE = 65535;
const STEPS = 65534;

function bytes(text) {
  const binary = atob(text);
  const out = new Uint8Array(binary.length);
  for (let k = 0; k < binary.length; k++) out[k] = binary.charCodeAt(k);
  return out.buffer;
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
