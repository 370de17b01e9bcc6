// Weights of the views for a synthetic aperture: the part of each view's square that lies inside,
// as in lf_flame/refocus/aperture.py.

/** Positions of n views from their middle. */
export function centred(n) {
  return Array.from({ length: n }, (_, i) => i - (n - 1) / 2);
}

/** Area under the upper half of the unit circle, from 0 to x. */
function underCircle(x) {
  return (x * Math.sqrt(1 - x * x) + Math.asin(x)) / 2;
}

/** Area of the unit disc between the axes and (y, x), with the sign of y x. */
function areaTo(y, x) {
  const sign = Math.sign(y) * Math.sign(x);
  const up = Math.min(Math.abs(y), 1);
  const across = Math.min(Math.abs(x), 1);
  const corner = Math.sqrt(1 - up * up); // where the circle meets the height y
  const beyond = underCircle(across) - underCircle(corner) + up * corner;
  return sign * (across <= corner ? across * up : beyond);
}

/** Edges of the views' squares, from the aperture's centre, in halves of its width. */
function edges(n, width, centre) {
  return centred(n + 1).map((edge) => (2 * (edge - centre)) / n / width);
}

const clip = (x, low, high) => Math.min(Math.max(x, low), high);

function disc(views, diameter, centre) {
  const width = Math.min(diameter, 4);
  const [down, right] = views.map((n, axis) => edges(n, width, centre[axis]));
  const whole = views[0] * views[1] * (width / 2) ** 2;
  const weights = [];
  for (let v = 0; v < views[0]; v++) {
    for (let u = 0; u < views[1]; u++) {
      const inside =
        areaTo(down[v + 1], right[u + 1]) - areaTo(down[v], right[u + 1]) -
        areaTo(down[v + 1], right[u]) + areaTo(down[v], right[u]);
      weights.push(clip(inside * whole, 0, 1));
    }
  }
  return weights;
}

function square(views, width, centre) {
  const [down, right] = views.map((n, axis) => {
    const ends = edges(n, width, centre[axis]).map((edge) => clip(edge, -1, 1));
    return centred(n).map((_, i) => ((ends[i + 1] - ends[i]) * n * width) / 2);
  });
  return down.flatMap((y) => right.map((x) => clip(y * x, 0, 1)));
}

/**
 * Weight of each view, row by row, from 0 to 1.
 *
 * views: [rows, columns]; width, and ring, of a covered middle, in widths of the full aperture;
 * centre in view steps.
 */
export function apertureWeights(views, { shape, width, ring, centre }) {
  const open = shape === "round" ? disc : square;
  const weights = open(views, width, centre);
  if (!ring) return weights;
  const covered = open(views, ring, centre);
  return weights.map((weight, i) => clip(weight - covered[i], 0, 1));
}
