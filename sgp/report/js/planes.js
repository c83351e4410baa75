// Planes: from base64 text to typed arrays. The counterpart of planes.py.

/** Decode a plane of the page: {name, kind, rows, columns, channels, bits, ...} and its text. */
export async function decodePlane(header, text) {
  const packed = fromBase64(text);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = header.rows * header.columns;
  const wide = header.bits === 16;
  const samples = new (wide ? Uint16Array : Uint8Array)(count * header.channels);
  for (let channel = 0; channel < header.channels; channel++) {
    const start = channel * count * (wide ? 2 : 1);
    const low = bytes.subarray(start, start + count);
    const high = wide ? bytes.subarray(start + count, start + 2 * count) : null;
    undoDifferences(low, high, header, channel, samples);
  }
  return { ...header, samples };
}

function fromBase64(text) {
  const binary = atob(text.trim());
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** Add each difference to its prediction from the left, upper and upper-left neighbours. */
function undoDifferences(low, high, { rows, columns, channels, bits }, channel, samples) {
  const top = bits === 16 ? 65535 : 255;
  const across = columns * channels;
  let place = channel;
  for (let row = 0, i = 0; row < rows; row++) {
    let left = 0;
    let corner = 0;
    for (let column = 0; column < columns; column++, i++, place += channels) {
      const up = row > 0 ? samples[place - across] : 0;
      const slope = left + up - corner;
      const least = left < up ? left : up;
      const most = left < up ? up : left;
      const predicted = slope < least ? least : slope > most ? most : slope;
      const folded = high === null ? low[i] : low[i] | (high[i] << 8);
      const difference = (folded >>> 1) ^ -(folded & 1);
      left = (predicted + difference) & top;
      samples[place] = left;
      corner = up;
    }
  }
}

/** Return the numbers of a scalar plane; NaN where it has no value. */
export function numbers({ samples, low, step }) {
  const values = new Float32Array(samples.length);
  for (let i = 0; i < values.length; i++) {
    values[i] = samples[i] === 0 ? NaN : low + step * (samples[i] - 1);
  }
  return values;
}
