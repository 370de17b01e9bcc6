// What lies over the picture: slope map, everything in focus, box and place.

import { colourOf, VIRIDIS } from "./colours.js";
import { display, showable } from "./display.js";

/** Slope map as it comes: slopes in float32, whether they are certain, the image in focus. */
export function readMap(buffer, { size, channels }) {
  const pixels = size[0] * size[1];
  return {
    width: size[1],
    slope: new Float32Array(buffer, 0, pixels),
    certain: new Uint8Array(buffer, 4 * pixels, pixels),
    focus: new Uint8Array(buffer, 5 * pixels, pixels * channels), // 255 is white
  };
}

/** Median slope of the certain pixels of a box, or nothing where there are none. */
export function slopeOfRegion(map, [top, bottom, left, right]) {
  const slopes = [];
  for (let row = top; map && row < bottom; row++) {
    for (let at = row * map.width + left; at < row * map.width + right; at++) {
      if (map.certain[at]) slopes.push(map.slope[at]);
    }
  }
  slopes.sort((a, b) => a - b);
  return slopes.length ? slopes[Math.floor(slopes.length / 2)] : null;
}

function mapColours({ slope, certain, width }, [low, high]) {
  const height = slope.length / width;
  const image = new ImageData(width, height);
  slope.forEach((value, i) => {
    const colour = certain[i] ? colourOf(VIRIDIS, (value - low) / (high - low)) : [128, 128, 128];
    image.data.set([...colour, 255], 4 * i);
  });
  return image;
}

function inFocus({ focus, width }, { channels }, { gain, gamma }) {
  const show = display({ levels: 255, low: 0, high: 1, white: 1 }, gain, gamma);
  return new ImageData(showable(focus, channels, show), width);
}

export function drawOverlay(canvas, metadata, state, { place }) {
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  const { map, slopes } = metadata;
  if (state.overlay !== "none" && map) {
    map.colours ??= mapColours(map, slopes);
    const image = state.overlay === "slope" ? map.colours : inFocus(map, metadata, state);
    context.putImageData(image, 0, 0);
    canvas.style.opacity = state.overlay === "slope" ? state.opacity : 1;
  } else canvas.style.opacity = 1;
  context.lineWidth = 1;
  for (const [colour, dash] of [["#000", []], ["#fff", [3, 3]]]) {
    context.strokeStyle = colour;
    context.setLineDash(dash);
    if (state.region) {
      const [top, bottom, left, right] = state.region;
      context.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
    }
    if (place) {
      const [row, column] = place;
      context.strokeRect(column - 2.5, row - 2.5, 6, 6);
    }
  }
}
