// What is looked at, as in the address: a link shows the same picture.

const number = (text) => (text.trim() === "" ? NaN : Number(text));

const WHOLE = { shape: "square", width: 1, ring: 0, centre: [0, 0] };

export function initialState({ slope, colours }) {
  return {
    slope, ...WHOLE,
    gain: 1, gamma: 1, colours: colours ?? "grey", overlay: "none", opacity: 0.6, region: null,
  };
}

/** Bring each value into its range; what is no number becomes what it was before. */
export function checked(state, before, metadata) {
  const { views, size, slopes } = metadata;
  const least = 1 / Math.max(...views);
  const within = (name, low, high) => {
    const value = Number(state[name]);
    return Number.isFinite(value) ? Math.min(Math.max(value, low), high) : before[name];
  };
  const width = within("width", least, state.shape === "round" ? Math.SQRT2 : 1);
  return {
    slope: within("slope", ...slopes),
    shape: state.shape === "round" ? "round" : "square",
    width,
    ring: Math.min(within("ring", 0, 1), width - least / 2),
    centre: views.map((n, axis) => {
      const value = Number(state.centre?.[axis]);
      const most = (n - 1) / 2;
      return Number.isFinite(value) ? Math.min(Math.max(value, -most), most) : 0;
    }),
    gain: within("gain", 0.1, 32),
    gamma: within("gamma", 0.2, 5),
    colours: state.colours === "inferno" && metadata.channels === 1 ? "inferno" : "grey",
    overlay: ["slope", "focus"].includes(state.overlay) && metadata.has_map ? state.overlay : "none",
    opacity: within("opacity", 0, 1),
    region: regionWithin(state.region, size),
  };
}

function regionWithin(region, [height, width]) {
  if (!Array.isArray(region) || region.length !== 4 || !region.every(Number.isInteger)) return null;
  const [top, bottom, left, right] = region;
  const inside = 0 <= top && top < bottom && bottom <= height && 0 <= left && left < right;
  return inside && right <= width ? region : null;
}

/** The part of an address after #: what differs from the first picture. */
export function toAddress(state, first) {
  const parts = new URLSearchParams();
  for (const [name, value] of Object.entries(state)) {
    const text = String(value ?? "");
    if (text !== String(first[name] ?? "")) parts.set(name, text);
  }
  return parts.toString();
}

/** State from an address; whatever else stands there is passed over. */
export function fromAddress(text, first, metadata) {
  const parts = new URLSearchParams(text.replace(/^#/, ""));
  const state = { ...first };
  for (const [name, value] of parts) {
    if (!(name in first)) continue;
    if (name === "centre" || name === "region") state[name] = value.split(",").map(number);
    else state[name] = typeof first[name] === "number" ? number(value) : value;
  }
  return checked(state, first, metadata);
}
