// The data of the page: a header and typed arrays, as masat/viewing/payload.py packs them.

const ARRAY_TYPES = {
  f4: Float32Array, f8: Float64Array, i4: Int32Array, i8: BigInt64Array, u1: Uint8Array, u2: Uint16Array,
};

/** Return the header, with `arrays`: flat typed arrays by name, each with its `shape`. */
export async function unpack(text) {
  const stream = new Blob([fromBase64(text.trim())]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = await new Response(stream).arrayBuffer();
  const begin = 4 + new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, begin - 4)));
  for (const [name, { type, shape, offset }] of Object.entries(header.arrays)) {
    const count = shape.reduce((product, size) => product * size, 1);
    const array = new ARRAY_TYPES[type](data, begin + offset, count);
    array.shape = shape;
    header.arrays[name] = array;
  }
  return header;
}

function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = letters.charCodeAt(k);
  return bytes;
}
