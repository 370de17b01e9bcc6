// Native controls: keys, fingers and screen readers know them.

import { command, depthOf, python } from "./words.js";

const signed = (x, digits) => (x < 0 ? "−" : "+") + Math.abs(x).toFixed(digits);

export class Controls {
  constructor(viewer) {
    this.viewer = viewer;
    this.form = viewer.find(".lf-controls");
    this.ranges = {};
    this.count = 0;
    const { views, channels, slopes, source, depths_mm } = viewer.metadata;
    const focus = this.group(depths_mm ? "Plane" : "Focus");
    this.range(focus, depths_mm ? "Depth" : "Slope", "slope", slopes[0], slopes[1], 0.01);
    if (!depths_mm) this.offerAperture(views);
    const shown = (this.shown = this.group("Display"));
    this.range(shown, "Gain", "gain", 0.1, 8, 0.05);
    this.range(shown, "Gamma", "gamma", 0.2, 5, 0.05);
    if (channels === 1) this.choice(shown, "Colours", "colours", { grey: "grey", inferno: "inferno" });
    const buttons = this.group("This picture");
    if (source) {
      this.button(buttons, "Copy command", () => this.copy(command));
      this.button(buttons, "Copy Python", () => this.copy(python));
    }
    this.button(buttons, "Start again", () => viewer.set(viewer.first));
    this.code = buttons.appendChild(document.createElement("code"));
    this.form.addEventListener("submit", (event) => event.preventDefault());
  }

  offerAperture(views) {
    const least = 1 / Math.max(...views);
    const aperture = this.group("Aperture");
    this.choice(aperture, "Shape", "shape", { square: "square", round: "round" });
    // Steps count from the lower end: 1 must be one of them.
    this.range(aperture, "Width", "width", Math.floor(100 * least) / 100, 1, 0.01);
    this.range(aperture, "Covered middle", "ring", 0, 1, 0.01);
    const viewpoint = this.group("Viewpoint");
    views.forEach((n, axis) => {
      const name = ["Up and down", "Left and right"][axis];
      this.range(viewpoint, name, `centre ${axis}`, -(n - 1) / 2, (n - 1) / 2, 0.05);
    });
  }

  offerOverlays() {
    const overlays = { none: "none", slope: "slope map", focus: "everything in focus" };
    this.choice(this.shown, "Overlay", "overlay", overlays);
    this.range(this.shown, "Opacity", "opacity", 0, 1, 0.05);
  }

  group(name) {
    const group = this.form.appendChild(document.createElement("fieldset"));
    group.appendChild(document.createElement("legend")).textContent = name;
    return group;
  }

  labelled(group, text, control) {
    const label = group.appendChild(document.createElement("label"));
    label.append(text, control);
    return label;
  }

  range(group, text, name, min, max, step) {
    const input = Object.assign(document.createElement("input"), { type: "range", min, max });
    input.step = step;
    const label = this.labelled(group, text, input);
    label.classList.toggle("lf-wide", name === "slope"); // its value is long, and it is used most
    const output = label.appendChild(document.createElement("span"));
    output.setAttribute("aria-hidden", "true"); // aria-valuetext says it
    this.ranges[name] = { input, output };
    input.addEventListener("input", () => this.change(name, Number(input.value)));
  }

  choice(group, text, name, options) {
    const select = document.createElement("select");
    for (const [value, words] of Object.entries(options)) select.add(new Option(words, value));
    this.labelled(group, text, select);
    this.ranges[name] = { input: select };
    select.addEventListener("change", () => this.change(name, select.value));
  }

  button(group, text, action) {
    const button = group.appendChild(document.createElement("button"));
    Object.assign(button, { type: "button", textContent: text });
    button.addEventListener("click", action);
  }

  change(name, value) {
    const [field, axis] = name.split(" ");
    const { centre } = this.viewer.state;
    this.viewer.set({ [field]: axis ? centre.map((at, i) => (i === Number(axis) ? value : at)) : value });
  }

  async copy(words) {
    const text = words(this.viewer.metadata, this.viewer.state);
    this.code.textContent = text;
    try {
      await navigator.clipboard.writeText(text);
      this.viewer.say("Copied.");
    } catch {
      this.viewer.say("This browser does not let a page copy; the text stands below the buttons.");
    }
  }

  show() {
    const { state, metadata } = this.viewer;
    for (const [name, { input, output }] of Object.entries(this.ranges)) {
      const [field, axis] = name.split(" ");
      const value = axis ? state[field][axis] : state[field];
      if (field === "width") input.max = state.shape === "round" ? Math.SQRT2 : 1;
      if (document.activeElement !== input || input.value !== String(value)) input.value = value;
      if (!output) continue;
      output.textContent = this.describe(field, value, metadata, state);
      input.setAttribute("aria-valuetext", output.textContent);
    }
    const image = this.viewer.find(".lf-image");
    const at = this.describe("slope", state.slope, metadata, state);
    const what = metadata.depths_mm ? "plane at" : "refocused at slope";
    image.setAttribute("aria-label", `${metadata.title}, ${what} ${at}`);
  }

  describe(field, value, { camera } = this.viewer.metadata, state = this.viewer.state) {
    if (field === "slope" && this.viewer.metadata.depths_mm) return `${signed(value, 2)} mm`;
    if (field === "slope" && camera) {
      const depth = depthOf(camera, value);
      const unknown = Number.isNaN(depth) ? "outside the calibration" : "beyond infinity";
      const where = Number.isFinite(depth) ? `${signed(depth, 1)} mm` : unknown;
      return `${signed(value, 2)}, ${where}`;
    }
    if (field === "slope" || field === "centre") return signed(value, 2);
    if (field === "width" && camera?.f_number && state.shape === "round") {
      return `${value.toFixed(2)}, f/${(camera.f_number / value).toFixed(1)}`;
    }
    return value.toFixed(2);
  }
}
