// The viewer: a picture refocused while one drags, and its sources.

import { apertureWeights } from "./aperture.js";
import { filterOf, gradient, INFERNO, VIRIDIS } from "./colours.js";
import { Controls } from "./controls.js";
import { display } from "./display.js";
import { drawSlices, slicesOf } from "./epi.js";
import { drawOverlay, readMap, slopeOfRegion } from "./overlay.js";
import { Pointing } from "./pointing.js";
import { SoftwareRenderer } from "./software.js";
import { load } from "./source.js";
import { brightestDepth, planeWeights, valueAt } from "./stack.js";
import { checked, fromAddress, initialState } from "./state.js";
import { hasFastWebGL, WebGLRenderer } from "./webgl.js";

const MARKUP = `
  <div class="lf-stage">
    <div class="lf-frame"><div class="lf-picture">
      <canvas class="lf-image" role="img"></canvas>
      <canvas class="lf-over" tabindex="0" role="application"
        aria-label="Place in the picture: arrow keys move it, Enter focuses there"></canvas>
    </div></div>
    <progress class="lf-progress" max="1" value="0" aria-label="Loading the views"></progress>
    <p class="lf-scale" hidden><span></span><i></i><span></span></p>
    <p class="lf-hint"></p>
    <p class="lf-status" role="status"></p>
    <div class="lf-slices" hidden>
      <figure><canvas class="lf-row"></canvas>
        <figcaption>Row under the pointer, in the views beside each other</figcaption></figure>
      <figure><canvas class="lf-column"></canvas>
        <figcaption>Column under the pointer, in the views above each other</figcaption></figure>
    </div>
  </div>
  <form class="lf-controls" aria-label="Focus, aperture and display"></form>
  ${filterOf(INFERNO, "lf-inferno")}`;

/** What is drawn before all views are there: the middle one, or what has come in. */
function weightsOf(loaded, { views, weights: own, depths_mm }, state) {
  const aperture = depths_mm ? planeWeights(depths_mm, state.slope) : apertureWeights(views, state);
  const both = own ? aperture.map((weight, i) => weight * own[i]) : aperture;
  const weights = both.some((weight) => weight > 0) ? both : aperture;
  if (!loaded.includes(false)) return weights;
  const some = weights.map((weight, i) => (loaded[i] ? weight : 0));
  return some.some((weight) => weight > 0) ? some : loaded.map(Number);
}

const boxOf = ([row, column]) => [row, row + 1, column, column + 1];

export class Viewer {
  /**
   * Fill an element with the viewer.
   *
   * metadata: of lf_flame/viewer/exhibit.py; source: of source.js; options: the address to open
   * with, a renderer to insist on ("webgl" or "javascript").
   */
  constructor(element, metadata, source, { address = "", renderer } = {}) {
    element.classList.add("lf-viewer");
    element.innerHTML = MARKUP;
    Object.assign(this, { element, metadata, source, listeners: [] });
    this.first = initialState(metadata);
    this.state = fromAddress(address, this.first, metadata);
    const { size } = metadata;
    this.renderer = this.chooseRenderer(renderer);
    this.renderer.drawn = () => this.trouble && this.say("");
    this.renderer.failed = (words) => this.say(words, true);
    Object.assign(this.find(".lf-over"), { height: size[0], width: size[1] });
    const picture = this.find(".lf-picture").style;
    picture.aspectRatio = `${size[1]} / ${size[0]}`;
    picture.width = `calc(var(--room) * ${size[1] / size[0]})`; // a tall one fits the window too
    if (metadata.depths_mm) {
      this.find(".lf-row + figcaption").textContent = "Row under the pointer, planes above each other";
      this.find(".lf-column").parentNode.hidden = true;
      this.find(".lf-slices").style.gridTemplateColumns = "1fr";
    }
    this.hint();
    this.controls = new Controls(this);
    this.pointing = new Pointing(this);
    this.ready = this.load();
  }

  chooseRenderer(asked) {
    const { views, positions, size, channels, levels } = this.metadata;
    const shape = { views, positions, size, channels, levels };
    const canvas = this.find(".lf-image");
    const length = views[0] * views[1] * size[0] * size[1] * channels;
    this.codes = new (levels > 255 ? Uint16Array : Uint8Array)(length);
    this.loaded = Array(views[0] * views[1]).fill(false);
    const fast = asked ? asked === "webgl" : hasFastWebGL(shape);
    return new (fast ? WebGLRenderer : SoftwareRenderer)(canvas, shape, this.codes);
  }

  find(selector) {
    return this.element.querySelector(selector);
  }

  /** Say what a click does, and what is known of the place under the pointer. */
  hint(place = this.pointed) {
    this.pointed = place;
    const { map, has_map, depths_mm } = this.metadata;
    let words = depths_mm
      ? "Drag the depth; a click goes to the brightest plane of the place."
      : "Drag the slope to focus.";
    if (depths_mm && place) {
      const value = valueAt(this.codes, this.metadata, place, this.state.slope);
      words = `Here: ${value.toPrecision(3)}. ${words}`;
    }
    if (has_map) words += " Or click a place, or drag a box: the focus goes there.";
    if (map && place) {
      const slope = slopeOfRegion(map, boxOf(place));
      words = slope === null
        ? "Here the slope is not certain (too little texture): drag a larger box, or the slope."
        : `Here: slope ${this.controls.describe("slope", slope)}. A click focuses on it.`;
    }
    this.find(".lf-hint").textContent = words;
  }

  /** Say something; a trouble is unsaid by the next picture. */
  say(words, trouble = false) {
    this.find(".lf-status").textContent = words;
    Object.assign(this, { trouble, unsure: false });
  }

  async load() {
    const { metadata, source } = this;
    try {
      await this.loadViews();
      this.draw();
      this.find(".lf-progress").hidden = true;
      this.say("");
      if (!source.slopeMap) return;
      this.say("The slope map is being made ...");
      metadata.map = readMap(await source.slopeMap(), metadata);
    } catch (error) {
      this.say(error.message);
      throw error;
    }
    this.say("");
    this.hint();
    this.controls.offerOverlays();
    this.set({});
  }

  loadViews() {
    const { metadata, source, codes, loaded } = this;
    return load(metadata, source.piece, codes, (first, count) => {
      this.renderer.add(first, count);
      loaded.fill(true, first, first + count);
      this.find(".lf-progress").value = loaded.filter(Boolean).length / loaded.length;
      this.draw();
    });
  }

  displayed() {
    return display(this.metadata, this.state.gain, this.state.gamma);
  }

  set(changes) {
    this.state = checked({ ...this.state, ...changes }, this.state, this.metadata);
    if (this.unsure) this.say("");
    this.hint();
    this.draw();
    for (const listener of this.listeners) listener(this.state);
  }

  /** Draw in the next frame, once however often it is asked for. */
  draw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      const { state, metadata } = this;
      this.renderer.draw({
        slope: metadata.depths_mm ? 0 : state.slope,
        weights: weightsOf(this.loaded, metadata, state),
        show: this.displayed(),
      });
      this.colour();
      drawOverlay(this.find(".lf-over"), metadata, state, this.pointing);
      this.controls.show();
      if (this.pointed) this.slicesAt(...this.pointed);
    });
  }

  /** Colour the greys, and show the scale of what has one: the slope map, or false colours. */
  colour() {
    const { state, metadata, controls } = this;
    const coloured = state.colours === "inferno";
    for (const name of [".lf-image", ".lf-row", ".lf-column"]) {
      this.find(name).style.filter = coloured ? "url(#lf-inferno)" : "";
    }
    const focused = coloured && state.overlay === "focus";
    this.find(".lf-over").style.filter = focused ? "url(#lf-inferno)" : "";
    const map = state.overlay === "slope" && metadata.map;
    const scale = this.find(".lf-scale");
    scale.hidden = !map && !coloured;
    if (scale.hidden) return;
    const ends = map
      ? metadata.slopes.map((slope) => controls.describe("slope", slope))
      : ["0", Number((metadata.white / state.gain).toPrecision(3))];
    scale.querySelectorAll("span").forEach((end, i) => (end.textContent = ends[i]));
    scale.querySelector("i").style.background = gradient(map ? VIRIDIS : INFERNO);
  }

  async drawn() {
    do await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    while (this.frame !== undefined || this.renderer.busy);
  }

  focusAt(...place) {
    const { metadata, codes } = this;
    if (metadata.depths_mm) return this.set({ slope: brightestDepth(codes, metadata, place) });
    this.focusOn(boxOf(place), "The slope of this place is not certain");
  }

  /** Focus on what a box holds, which is kept unless it is a place. */
  focusOn(box, unsure) {
    if (this.metadata.depths_mm) return;
    const { map, has_map } = this.metadata;
    const slope = slopeOfRegion(map, box);
    const changes = unsure ? {} : { region: box };
    if (slope !== null) {
      this.set({ region: null, ...changes, slope });
      return;
    }
    this.set(changes);
    const why = `${unsure ?? "No slope in this box is certain"}: there is too little texture.`;
    this.say(map ? why : has_map ? "The slope map is not there yet." : "There is no slope map.");
    this.unsure = true;
  }

  slicesAt(row, column) {
    this.find(".lf-slices").hidden = false;
    const canvases = [".lf-row", ".lf-column"].map((name) => this.find(name));
    const { codes, metadata } = this;
    drawSlices(canvases, slicesOf(codes, metadata, row, column), metadata, this.displayed());
  }

  close() {
    this.renderer.close();
  }
}
