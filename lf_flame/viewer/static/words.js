// The command and the line of Python that make the picture shown.

const shellQuoted = (text) => `'${text.replaceAll("'", `'\\''`)}'`;
const short = (x) => String(Number(x.toPrecision(6)));

const isWhole = ({ shape, width, ring, centre }) =>
  shape === "square" && width === 1 && ring === 0 && centre.every((at) => at === 0);

/** Call of the program, to be typed in a shell. */
export function command(metadata, state) {
  const words = ["lf-flame refocus", shellQuoted(metadata.source), ...metadata.reading.map(shellQuoted)];
  words.push(`--slope ${short(state.slope)}`);
  if (!isWhole(state)) {
    words.push(`--aperture ${short(state.width)}`);
    if (state.shape === "square") words.push("--square");
    if (state.ring) words.push(`--ring ${short(state.ring)}`);
    if (state.centre.some((at) => at !== 0)) words.push(`--viewpoint ${state.centre.map(short).join(" ")}`);
  }
  if (state.gain !== 1) words.push(`--gain ${short(state.gain)}`);
  if (state.gamma !== 1) words.push(`--gamma ${short(state.gamma)}`);
  return words.join(" ");
}

/** Lines of Python; JSON's strings are Python's. */
export function python(metadata, state) {
  const lines = [
    "from lf_flame import read_light_field",
    "from lf_flame.refocus import refocus",
    `light_field = read_light_field(${JSON.stringify(metadata.source)})`,
  ];
  let weights = "";
  if (!isWhole(state)) {
    const { shape, width, ring, centre } = state;
    lines.push("from lf_flame.refocus import aperture_weights");
    lines.push(
      `weights = aperture_weights(light_field.views.shape[:2], ${short(width)}, ` +
        `ring=${short(ring)}, shape="${shape}", centre=(${centre.map(short).join(", ")}))`,
    );
    weights = ", weights=weights";
  }
  lines.push(`image = refocus(light_field, [${short(state.slope)}]${weights})[0]`);
  return lines.join("\n");
}

/** Depth in mm at a slope, of a known camera; infinite beyond what it can focus on. */
export function depthOf({ focus_distance_mm, shift_per_slope }, slope) {
  const shift = slope * shift_per_slope;
  return shift < 1 ? (focus_distance_mm * shift) / (1 - shift) : Infinity;
}
