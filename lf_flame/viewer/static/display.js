// From radiance to what a screen shows.

/** Factor and offset from codes to parts of white; exponent of gamma. */
export function display({ levels, low, high, white }, gain, gamma) {
  return { scale: (gain * (high - low)) / white / levels, offset: (gain * low) / white, exponent: 1 / gamma };
}

export function paint(canvas, values, [height, width], channels, show) {
  const levels = showable(values, channels, show);
  Object.assign(canvas, { height, width });
  canvas.getContext("2d").putImageData(new ImageData(levels, width, height), 0, 0);
}

/** Levels of RGBA for values in codes. */
export function showable(values, channels, { scale, offset, exponent }) {
  const pixels = values.length / channels;
  const out = new Uint8ClampedArray(4 * pixels); // which rounds
  for (let i = 0; i < pixels; i++) {
    for (let c = 0; c < 3; c++) {
      const value = scale * values[i * channels + (channels === 3 ? c : 0)] + offset;
      out[4 * i + c] = 255 * Math.min(Math.max(value, 0), 1) ** exponent;
    }
    out[4 * i + 3] = 255;
  }
  return out;
}
