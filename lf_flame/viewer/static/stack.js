// A stack of planes in depth, such as emission, in the place of views: no view moves, a picture is
// between the two nearest planes.

/** Weight of each plane at a depth. */
export function planeWeights(depths, depth) {
  const weights = depths.map(() => 0);
  const above = depths.findIndex((at) => at >= depth);
  if (above <= 0) weights[above < 0 ? depths.length - 1 : 0] = 1;
  else {
    const part = (depth - depths[above - 1]) / (depths[above] - depths[above - 1]);
    weights[above - 1] = 1 - part;
    weights[above] = part;
  }
  return weights;
}

/** Values of all planes at a place of the picture. */
export function courseAt(codes, { size, depths_mm, levels, low, high }, [row, column]) {
  const [height, width] = size;
  return depths_mm.map((_, k) => low + ((high - low) * codes[(k * height + row) * width + column]) / levels);
}

/** Value at a place and depth. */
export function valueAt(codes, metadata, place, depth) {
  const weights = planeWeights(metadata.depths_mm, depth);
  return courseAt(codes, metadata, place).reduce((sum, value, k) => sum + weights[k] * value, 0);
}

/** Depth of the brightest plane at a place. */
export function brightestDepth(codes, metadata, place) {
  const course = courseAt(codes, metadata, place);
  return metadata.depths_mm[course.indexOf(Math.max(...course))];
}
