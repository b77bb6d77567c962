// What the page holds, decoded: gzipped columns in base64, written by gaga_core/io/web_page.py.

const WIDTH = 2048; // texels of a line of every data texture, as in common.glsl

/** Text of an inert element of the page, which is taken out of it. */
function takeText(id) {
  const element = document.getElementById(id);
  const text = element.textContent;
  element.remove();
  return text;
}

function bytesOfBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

/** A gzipped column of the page. */
async function takeColumn(id) {
  const packed = bytesOfBase64(takeText(id));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * All columns as the shaders read them, with room for whole lines of texels.
 * `head` is the page's JSON; numbers are rounded as in a SOG.
 */
async function decodeSplats(head) {
  const n = head.count;
  const lines = Math.max(1, Math.ceil(n / WIDTH));
  const room = lines * WIDTH;
  const splats = { n, lines, nSh: head.nSh, logScale: scaleRange(head.sizes) };
  splats.means = decodeMeans(await takeColumn("means"), n, room, head.low, head.high);
  const turns = await takeColumn("turns");
  const sizes = await takeColumn("sizes");
  const looks = await takeColumn("looks");
  Object.assign(splats, decodeShape(turns, sizes, looks, head.sizes, n, room));
  splats.color = decodeColor(looks, head.colors, n, room);
  if (head.nSh > 1) {
    const places = wordsOf(await takeColumn("sh-places"), n);
    splats.layers = Math.ceil((3 * (head.nSh - 1)) / 8);
    splats.sh = decodeRest(await takeColumn("sh"), places, head, splats.color, splats.layers, room);
  }
  splats.labels = new Int32Array(room);
  splats.labels.set(wordsOf(await takeColumn("labels"), n));
  return splats;
}

/** Numbers of 16 bits from a plane of low bytes and one of high bytes. */
function wordsOf(planes, n) {
  const words = new Uint16Array(n);
  for (let i = 0; i < n; i++) words[i] = planes[i] | (planes[n + i] << 8);
  return words;
}

function scaleRange(table) {
  const low = table[0];
  return [low, Math.max(table[table.length - 1] - low, 1e-3)];
}

/** Positions on a scale of sign(x) ln(1 + |x|), in six planes of bytes. */
function decodeMeans(planes, n, room, low, high) {
  const means = new Float32Array(3 * room);
  for (let axis = 0; axis < 3; axis++) {
    const words = wordsOf(planes.subarray(2 * axis * n, 2 * (axis + 1) * n), n);
    const step = (high[axis] - low[axis]) / 65535;
    for (let i = 0; i < n; i++) {
      const log = low[axis] + step * words[i];
      means[3 * i + axis] = Math.sign(log) * Math.expm1(Math.abs(log));
    }
  }
  return means;
}

const OTHERS = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

/**
 * Quaternion, log scales and opacity as 8 x 16 bits; how far each splat can be seen; and its rank when
 * few are drawn: importance() of app/gaga_studio/gpu/sort_kernels.py, which project.frag knows, too.
 */
function decodeShape(turns, sizes, looks, table, n, room) {
  const shape = new Uint16Array(8 * room);
  const reach = new Float32Array(n);
  const importance = new Float32Array(n);
  const [low, range] = scaleRange(table);
  const fixed = table.map((log) => Math.round(((log - low) / range) * 65535));
  const quat = [0, 0, 0, 0];
  for (let i = 0; i < n; i++) {
    let rest = 1;
    const largest = turns[3 * n + i];
    for (let k = 0; k < 3; k++) {
      const part = (turns[k * n + i] / 255 - 0.5) * Math.SQRT2;
      quat[OTHERS[largest][k]] = part;
      rest -= part * part;
    }
    quat[largest] = Math.sqrt(Math.max(rest, 0));
    for (let k = 0; k < 4; k++) shape[8 * i + k] = Math.min(quat[k] * 32767.5 + 32768, 65535);
    let longest = 0, shortest = 255, sum = 0;
    for (let k = 0; k < 3; k++) {
      const code = sizes[k * n + i];
      longest = Math.max(longest, code); // the table ascends
      shortest = Math.min(shortest, code);
      sum += table[code];
      shape[8 * i + 4 + k] = fixed[code];
    }
    shape[8 * i + 7] = looks[3 * n + i] * 257;
    reach[i] = 3.34 * Math.exp(table[longest]);
    const weight = 0.5 * (sum - table[shortest] + Math.log(Math.max(looks[3 * n + i] / 255, 1e-6)));
    importance[i] = weight - Math.log(Math.max(((i + 1) * 0.6180339887498949) % 1, 1e-9));
  }
  return { shape, reach, importance };
}

function decodeColor(looks, table, n, room) {
  const color = new Float32Array(4 * room);
  for (let k = 0; k < 3; k++)
    for (let i = 0; i < n; i++) color[4 * i + k] = table[looks[k * n + i]];
  return color;
}

/** Coefficients above the first of each splat: shares in 127 steps of a scale, which goes to `color`. */
function decodeRest(codes, places, head, color, layers, room) {
  const width = 3 * (head.nSh - 1);
  const entries = codes.length / width;
  const shares = new Int8Array(entries * 8 * layers);
  const scales = new Float32Array(entries);
  for (let e = 0; e < entries; e++) {
    let most = 0;
    for (let k = 0; k < width; k++) {
      most = Math.max(most, Math.abs(head.shTable[codes[e * width + k]]));
    }
    scales[e] = most;
    for (let k = 0; k < width && most > 0; k++) {
      shares[e * 8 * layers + k] = Math.round((127 * head.shTable[codes[e * width + k]]) / most);
    }
  }
  // Eight bytes of a layer at once: two words.
  const words = new Int32Array(shares.buffer);
  const sh = new Uint32Array(2 * layers * room);
  for (let i = 0; i < places.length; i++) {
    const from = places[i] * 2 * layers;
    color[4 * i + 3] = scales[places[i]];
    for (let layer = 0; layer < layers; layer++) {
      sh[2 * (layer * room + i)] = words[from + 2 * layer];
      sh[2 * (layer * room + i) + 1] = words[from + 2 * layer + 1];
    }
  }
  return sh;
}
