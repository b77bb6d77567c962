// Depth order, far to near, in a thread of its own. Keys are the bits of the float32 depth, stretched
// over the range that is seen, as in app/gaga_studio/gpu/sort_kernels.py.
// NEAR is put before this text where the page is made.

const N_KEYS = 1 << 18;
let means, reach, labels, importance, keys, ids, counts;

self.onmessage = (event) => {
  const job = event.data;
  if (job.means) {
    ({ means, reach, labels, importance } = job);
    keys = new Float32Array(reach.length);
    ids = new Uint32Array(reach.length);
    counts = new Uint32Array(N_KEYS + 1);
    return;
  }
  const order = job.order;
  const count = sort(visible(job), order);
  self.postMessage({ ticket: job.ticket, threshold: job.threshold, order, count }, [order.buffer]);
};

/** Depths and ids of the splats above the threshold that can touch the picture; their number. */
function visible({ view, lens, size, hidden, threshold }) {
  const [fx, fy, cx, cy] = lens;
  const limit = 1.3 * 0.5 * Math.max(size[0] / fx, size[1] / fy);
  const stretch = Math.max(fx, fy) * Math.sqrt(1 + 2 * limit * limit);
  let n = 0;
  for (let i = 0; i < reach.length; i++) {
    if (hidden[labels[i]] || importance[i] < threshold) continue;
    const x = means[3 * i], y = means[3 * i + 1], z = means[3 * i + 2];
    const depth = view[8] * x + view[9] * y + view[10] * z + view[11];
    if (!(depth >= NEAR)) continue;
    const u = (fx * (view[0] * x + view[1] * y + view[2] * z + view[3])) / depth + cx;
    const v = (fy * (view[4] * x + view[5] * y + view[6] * z + view[7])) / depth + cy;
    const radius = (stretch * reach[i]) / depth + 2;
    if (u < -radius || v < -radius || u > size[0] + radius || v > size[1] + radius) continue;
    keys[n] = depth;
    ids[n++] = i;
  }
  return n;
}

function sort(n, order) {
  const bits = new Uint32Array(keys.buffer);
  let low = 0xffffffff, high = 0;
  for (let i = 0; i < n; i++) {
    low = Math.min(low, bits[i]);
    high = Math.max(high, bits[i]);
  }
  const scale = (N_KEYS - 1) / Math.max(high - low, 1);
  counts.fill(0);
  for (let i = 0; i < n; i++) {
    bits[i] = ((bits[i] - low) * scale) | 0;
    counts[bits[i] + 1]++;
  }
  for (let k = 0; k < N_KEYS; k++) counts[k + 1] += counts[k];
  for (let i = 0; i < n; i++) order[n - 1 - counts[bits[i]]++] = ids[i];
  return n;
}
