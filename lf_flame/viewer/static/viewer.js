// The viewer: a picture that is refocused while one drags, and what it is made from.

import { apertureWeights } from "./aperture.js";
import { Controls } from "./controls.js";
import { display } from "./display.js";
import { drawSlices } from "./epi.js";
import { drawOverlay, readMap, slopeAt, slopeOfRegion } from "./overlay.js";
import { Pointing } from "./pointing.js";
import { SoftwareRenderer } from "./software.js";
import { load } from "./source.js";
import { checked, fromAddress, initialState } from "./state.js";
import { hasFastWebGL, WebGLRenderer } from "./webgl.js";

const MARKUP = `
  <div class="lf-stage">
    <div class="lf-picture">
      <canvas class="lf-image" role="img"></canvas>
      <canvas class="lf-over" tabindex="0" role="application"
        aria-label="Place in the picture: arrow keys move it, Enter focuses there"></canvas>
    </div>
    <progress class="lf-progress" max="1" value="0" aria-label="Loading the views"></progress>
    <p class="lf-status" role="status"></p>
    <div class="lf-slices" hidden>
      <figure><canvas class="lf-row"></canvas>
        <figcaption>Row under the pointer, in the views beside each other</figcaption></figure>
      <figure><canvas class="lf-column"></canvas>
        <figcaption>Column under the pointer, in the views above each other</figcaption></figure>
    </div>
  </div>
  <form class="lf-controls" aria-label="Focus, aperture and display"></form>`;

/** What is drawn before all views are there: the middle one, or what has come in. */
function weightsOf(loaded, { views }, state) {
  const weights = apertureWeights(views, state);
  if (!loaded.includes(false)) return weights;
  const some = weights.map((weight, i) => (loaded[i] ? weight : 0));
  return some.some((weight) => weight > 0) ? some : loaded.map(Number);
}

export class Viewer {
  /**
   * Fill an element with the viewer.
   *
   * metadata: of lf_flame/viewer/exhibit.py; piece, slopeMap: of source.js; options: the address to
   * open with, a renderer to insist on ("webgl" or "javascript").
   */
  constructor(element, metadata, { piece, slopeMap }, { address = "", renderer } = {}) {
    element.classList.add("lf-viewer");
    element.innerHTML = MARKUP;
    Object.assign(this, { element, metadata, listeners: [] });
    this.first = initialState(metadata);
    this.state = fromAddress(address, this.first, metadata);
    const { views, positions, size, channels, levels } = metadata;
    const shape = { views, positions, size, channels, levels };
    const length = views[0] * views[1] * size[0] * size[1] * channels;
    this.codes = new (levels > 255 ? Uint16Array : Uint8Array)(length);
    this.loaded = Array(views[0] * views[1]).fill(false);
    const fast = renderer ? renderer === "webgl" : hasFastWebGL(shape);
    const Renderer = fast ? WebGLRenderer : SoftwareRenderer;
    this.renderer = new Renderer(this.find(".lf-image"), shape, this.codes);
    this.renderer.drawn = () => this.note();
    this.renderer.failed = (words) => this.say(words);
    Object.assign(this.find(".lf-over"), { height: size[0], width: size[1] });
    const picture = this.find(".lf-picture").style;
    picture.aspectRatio = `${size[1]} / ${size[0]}`;
    picture.width = `min(100%, ${(75 * size[1]) / size[0]}vh)`; // a tall one fits the window too
    this.controls = new Controls(this);
    this.pointing = new Pointing(this);
    this.ready = this.load(piece, slopeMap);
  }

  find(selector) {
    return this.element.querySelector(selector);
  }

  say(words) {
    this.find(".lf-status").textContent = words;
  }

  async load(piece, slopeMap) {
    const { metadata } = this;
    try {
      await load(metadata, piece, this.codes, (first, count) => {
        this.renderer.add(first, count);
        this.loaded.fill(true, first, first + count);
        this.find(".lf-progress").value = this.loaded.filter(Boolean).length / this.loaded.length;
        this.draw();
      });
      this.find(".lf-progress").hidden = true;
      this.say("");
      if (!slopeMap) return;
      this.say("The slope map is being made ...");
      metadata.map = readMap(await slopeMap(), metadata);
    } catch (error) {
      this.say(error.message);
      throw error;
    }
    this.say("");
    this.controls.offerOverlays();
    this.set({});
  }

  /** Change some of the state, as controls, pointer and notebook do. */
  set(changes, { dragging = false } = {}) {
    this.state = checked({ ...this.state, ...changes }, this.state, this.metadata);
    this.draw(dragging);
    for (const listener of this.listeners) listener(this.state, dragging);
  }

  /** Draw in the next frame, once however often it is asked for. */
  draw(dragging = false) {
    this.dragging = dragging;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      const { state, metadata } = this;
      this.renderer.draw({
        slope: state.slope,
        weights: weightsOf(this.loaded, metadata, state),
        show: display(metadata, state.gain, state.gamma),
        dragging: this.dragging,
      });
      drawOverlay(this.find(".lf-over"), metadata, state, this.pointing);
      this.controls.show();
    });
  }

  /** Note when the first picture and that of all views were drawn, for whoever measures. */
  note() {
    const marks = this.loaded.includes(false) ? ["lf-first-picture"] : ["lf-first-picture", "lf-all-views"];
    for (const mark of marks) {
      if (!performance.getEntriesByName(mark).length) performance.mark(mark);
    }
    this.onDrawn?.();
  }

  /** Wait until nothing is left to be drawn. */
  async drawn() {
    do await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    while (this.frame !== undefined || this.renderer.busy);
  }

  /** Focus on a place where its slope is certain; say so where it is not. */
  focusAt(row, column) {
    const slope = slopeAt(this.metadata.map, row, column);
    if (slope === null) this.say("The slope of this place is not certain: there is too little texture.");
    else this.set({ slope, region: null });
  }

  /** Focus on what a box holds. */
  focusOn(region) {
    const slope = slopeOfRegion(this.metadata.map, region);
    this.set(slope === null ? { region } : { region, slope });
    if (slope === null) this.say("No slope in this box is certain.");
  }

  /** Show the row and the column of a place in all views (epipolar-plane images). */
  slicesAt(row, column) {
    this.find(".lf-slices").hidden = false;
    drawSlices(this.find(".lf-row"), this.find(".lf-column"), this, row, column);
  }

  close() {
    this.renderer.close();
  }
}
