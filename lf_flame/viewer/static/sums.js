// Shift-and-sum without a graphics processor: rows of views first, then their sums (separable).
// It is loaded as a Worker too, so it imports nothing.

/** Add two neighbouring taps of a line to another, clamped at the ends. */
function addLine(out, to, line, from, width, channels, whole, first, second) {
  const low = Math.min(Math.max(-whole, 0), width) * channels;
  const high = Math.min(Math.max(width - 1 - whole, 0), width) * channels;
  const both = first + second;
  const last = from + (width - 1) * channels;
  const offset = from + whole * channels;
  for (let x = 0; x < low; x++) out[to + x] += both * line[from + (x % channels)];
  for (let x = low; x < high; x++) {
    out[to + x] += first * line[offset + x] + second * line[offset + x + channels];
  }
  for (let x = Math.max(low, high); x < width * channels; x++) {
    out[to + x] += both * line[last + (x % channels)];
  }
}

/**
 * Refocus: values of shape (height, width, channels) in the unit of the codes.
 *
 * codes: views one after the other, row by row; plan: of planShifts.
 */
export function refocus(codes, { views, size, channels }, plan) {
  const [height, width] = size;
  const line = width * channels;
  const image = new Float64Array(height * line);
  const row = new Float64Array(height * line);
  for (let v = 0; v < views[0]; v++) {
    let used = false;
    row.fill(0);
    for (let u = 0; u < views[1]; u++) {
      const weight = plan.weights[v * views[1] + u];
      if (weight === 0) continue;
      used = true;
      const { whole, part } = plan.across[u];
      const view = (v * views[1] + u) * height * line;
      for (let t = 0; t < height; t++) {
        const first = weight * (1 - part);
        addLine(row, t * line, codes, view + t * line, width, channels, whole, first, weight * part);
      }
    }
    if (used) addRows(image, row, height, line, plan.down[v]);
  }
  return Float32Array.from(image);
}

function addRows(image, row, height, line, { whole, part }) {
  const clamped = (t) => Math.min(Math.max(t, 0), height - 1) * line;
  for (let t = 0; t < height; t++) {
    const above = clamped(t + whole);
    const below = clamped(t + whole + 1);
    const to = t * line;
    for (let x = 0; x < line; x++) {
      image[to + x] += (1 - part) * row[above + x] + part * row[below + x];
    }
  }
}

// A Worker is told the shape once, the codes in pieces, then plans.
if (typeof WorkerGlobalScope !== "undefined" && self instanceof WorkerGlobalScope) {
  let shape;
  let codes;
  self.onmessage = ({ data }) => {
    if (data.shape) {
      shape = data.shape;
      codes = new (data.wide ? Uint16Array : Uint8Array)(data.length);
    } else if (data.codes) {
      codes.set(data.codes, data.at);
    } else {
      const image = refocus(codes, shape, data.plan);
      self.postMessage({ image }, [image.buffer]);
    }
  };
}
