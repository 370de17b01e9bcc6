// Where each view is read at a slope, as in lf_flame/refocus/shift.py. Whole lenslets and the rest are
// kept apart: one float32 would miss the fraction by 1e-4 far out in a large image.

function shifts(positions, length, slope) {
  return positions.map((at) => {
    const shift = Math.min(Math.max(slope * at, -length), length);
    const whole = Math.floor(shift);
    return { whole, part: shift - whole };
  });
}

/**
 * Shifts of the rows and columns of views, and weights that sum to 1.
 *
 * positions: of the rows and columns of views, in view steps from the middle.
 */
export function planShifts({ positions, size }, slope, weights) {
  const sum = weights.reduce((total, weight) => total + weight, 0);
  return {
    down: shifts(positions[0], size[0], slope),
    across: shifts(positions[1], size[1], slope),
    weights: weights.map((weight) => weight / sum),
  };
}
