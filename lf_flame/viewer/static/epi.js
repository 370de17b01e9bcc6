// Epipolar-plane images: one row of the picture in the views beside each other, one column in those
// above each other. A surface is a straight line in them, its tilt the slope.

import { display, showable } from "./display.js";

function paint(canvas, values, height, width, channels, show) {
  const levels = showable(values, channels, show);
  Object.assign(canvas, { height, width });
  canvas.getContext("2d").putImageData(new ImageData(levels, width, height), 0, 0);
}

export function drawSlices(across, down, { codes, metadata, state }, row, column) {
  const { views, size, channels } = metadata;
  const [height, width] = size;
  const line = width * channels;
  const show = display(metadata, state.gain, state.gamma);
  const [v, u] = views.map((n) => Math.floor((n - 1) / 2));
  const beside = new Float32Array(views[1] * line);
  for (let i = 0; i < views[1]; i++) {
    const from = ((v * views[1] + i) * height + row) * line;
    beside.set(codes.subarray(from, from + line), i * line);
  }
  paint(across, beside, views[1], width, channels, show);
  const above = new Float32Array(views[0] * height * channels);
  for (let i = 0; i < views[0]; i++) {
    for (let t = 0; t < height; t++) {
      const from = (((i * views[1] + u) * height + t) * width + column) * channels;
      for (let c = 0; c < channels; c++) above[(i * height + t) * channels + c] = codes[from + c];
    }
  }
  paint(down, above, views[0], height, channels, show);
}
