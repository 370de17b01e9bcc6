// Perceptual colour maps of matplotlib at nine places, linear between.

export const VIRIDIS = [
  [68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
  [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37],
];
export const INFERNO = [
  [0, 0, 4], [33, 12, 74], [87, 16, 110], [138, 34, 106], [188, 55, 84],
  [228, 90, 49], [249, 142, 9], [249, 203, 53], [252, 255, 164],
];

export function colourOf(map, part) {
  const at = Math.min(Math.max(part, 0), 1) * (map.length - 1);
  const below = Math.min(Math.floor(at), map.length - 2);
  return map[below].map((x, c) => x + (at - below) * (map[below + 1][c] - x));
}

export const gradient = (map) => `linear-gradient(90deg,${map.map((x) => `rgb(${x})`)})`;

/** An SVG with a filter that turns the greys of a canvas into colours, whatever draws them. */
export function filterOf(map, name) {
  const tables = ["R", "G", "B"].map((letter, c) =>
    `<feFunc${letter} type="table" tableValues="${map.map((x) => x[c] / 255).join(" ")}"/>`);
  return `<svg width="0" height="0" class="lf-filter" aria-hidden="true"><filter id="${name}"
    color-interpolation-filters="sRGB"><feComponentTransfer>${tables.join("")}</feComponentTransfer></filter></svg>`;
}
