// Epipolar-plane images: a row of the picture over the view columns, a column over the view rows.
// A surface is a straight line in them, its tilt the slope.

import { paint } from "./display.js";

/** Rows beside each other, shape (u, s, channels), and columns above each other, (v, t, channels). */
export function slicesOf(codes, { views, size, channels }, row, column) {
  const [height, width] = size;
  const line = width * channels;
  const [v, u] = views.map((n) => Math.floor((n - 1) / 2));
  const beside = new Float32Array(views[1] * line);
  for (let i = 0; i < views[1]; i++) {
    const from = ((v * views[1] + i) * height + row) * line;
    beside.set(codes.subarray(from, from + line), i * line);
  }
  const above = new Float32Array(views[0] * height * channels);
  for (let i = 0; i < views[0]; i++) {
    for (let t = 0; t < height; t++) {
      const from = (((i * views[1] + u) * height + t) * width + column) * channels;
      for (let c = 0; c < channels; c++) above[(i * height + t) * channels + c] = codes[from + c];
    }
  }
  return [beside, above];
}

export function drawSlices(canvases, slices, { views, size, channels }, show) {
  const sizes = [[views[1], size[1]], [views[0], size[0]]];
  canvases.forEach((canvas, i) => paint(canvas, slices[i], sizes[i], channels, show));
}
