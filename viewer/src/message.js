// The messages of the explorer's session: a length, JSON, and the arrays that it names.

const KINDS = { "<f4": Float32Array, "<u4": Uint32Array };

// The JSON of a message (ArrayBuffer) and its arrays by name.
export function unpacked(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const said = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  const arrays = {};
  for (const [name, { at, shape, type }] of Object.entries(said.arrays)) {
    const count = shape.reduce((product, each) => product * each, 1);
    arrays[name] = new KINDS[type](buffer, 4 + size + at, count);
  }
  return { said, arrays };
}
