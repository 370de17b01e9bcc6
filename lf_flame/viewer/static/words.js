// The command and the Python that make the picture shown.

const shellQuoted = (text) => `'${text.replaceAll("'", `'\\''`)}'`;
const short = (x) => String(Number(x.toPrecision(6)));

const isWhole = ({ shape, width, ring, centre }) =>
  shape === "square" && width === 1 && ring === 0 && centre.every((at) => at === 0);

/** Viewpoint in views of the source, of which a page in one file may have every second. */
const viewpoint = ({ positions }, { centre }) =>
  centre.map((at, axis) => {
    const index = at + (positions[axis].length - 1) / 2;
    const [below, above] = [Math.floor(index), Math.ceil(index)].map((i) => positions[axis][i]);
    return short(below + (above - below) * (index % 1));
  });

// A name that begins with a dash would be taken for an option.
const asPath = (text) => shellQuoted(text.startsWith("-") ? `./${text}` : text);

/** Call of the program, to be typed in a shell. */
export function command(metadata, state) {
  const words = ["lf-flame refocus", asPath(metadata.source)];
  const all = state.overlay === "focus"; // made from all views, whatever the aperture
  for (const [name, value] of Object.entries(metadata.reading)) {
    words.push(`--${name.replace("_", "-")}=${shellQuoted(String(value))}`);
  }
  words.push(all ? `--map ${metadata.slopes.join(" ")}` : `--slope ${short(state.slope)}`);
  if (!all && !isWhole(state)) {
    words.push(`--aperture ${short(state.width)}`);
    if (state.shape === "square") words.push("--square");
    if (state.ring) words.push(`--ring ${short(state.ring)}`);
    if (state.centre.some((at) => at !== 0)) words.push(`--viewpoint ${viewpoint(metadata, state).join(" ")}`);
  }
  if (state.gain !== 1) words.push(`--gain ${short(state.gain)}`);
  if (state.gamma !== 1) words.push(`--gamma ${short(state.gamma)}`);
  return words.join(" ");
}

/** Lines of Python; JSON's strings are Python's. */
export function python(metadata, state) {
  const { camera, ...given } = metadata.reading;
  const options = Object.entries(given).map(([name, x]) => `${name}=${JSON.stringify(x)}`);
  const called = [JSON.stringify(metadata.source), ...options].join(", ");
  const lines = [
    "from lf_flame import read_light_field",
    "from lf_flame.refocus import refocus",
    `light_field = read_light_field(${called})`,
  ];
  if (camera) {
    lines.push("from lf_flame import read_lens");
    lines.push(`light_field = read_lens(${JSON.stringify(camera)}).corrected(light_field)`);
  }
  const all = state.overlay === "focus";
  let weights = "";
  if (!all && !isWhole(state)) {
    const { shape, width, ring } = state;
    lines.push("from lf_flame.refocus import aperture_weights");
    lines.push(
      `weights = aperture_weights(light_field.views.shape[:2], ${short(width)}, ` +
        `ring=${short(ring)}, shape="${shape}", centre=(${viewpoint(metadata, state).join(", ")}))`,
    );
    weights = ", weights=weights";
  }
  if (all) {
    lines[1] = "import numpy as np\nfrom lf_flame.refocus import all_in_focus";
    lines.push(`slopes = np.linspace(${metadata.slopes.join(", ")}, ${metadata.map_steps})`);
    lines.push("image = all_in_focus(light_field, slopes).all_in_focus");
  } else lines.push(`image = refocus(light_field, ${short(state.slope)}${weights})`);
  if (state.gain !== 1 || state.gamma !== 1) {
    const [factor, gamma] = [short(state.gain / metadata.white), short(state.gamma)];
    lines.push(`image = (image * ${factor}).clip(0, 1) ** (1 / ${gamma})`);
  }
  return lines.join("\n");
}

/** Depth in mm at a slope; infinite beyond what a camera can focus on, NaN outside a calibration. */
export function depthOf(camera, slope) {
  const { focus_distance_mm, shift_per_slope, focal_plane_mm = 0, range_mm } = camera;
  const shift = slope * shift_per_slope;
  const depth = shift < 1 ? focal_plane_mm + (focus_distance_mm * shift) / (1 - shift) : Infinity;
  return range_mm && (depth < range_mm[0] || depth > range_mm[1]) ? NaN : depth;
}
