// Draws without WebGL2: a Worker sums, the page goes on answering meanwhile.

import { paint } from "./display.js";
import { planShifts } from "./shifts.js";

/** Milliseconds before the page says that it waits. */
const A_MOMENT = 400;

export class SoftwareRenderer {
  constructor(canvas, shape, codes) {
    Object.assign(this, { canvas, shape, codes, name: "JavaScript" });
    this.worker = new Worker(new URL(import.meta.resolve("./sums.js")), { type: "module" });
    const wide = codes instanceof Uint16Array;
    this.worker.postMessage({ shape, wide, length: codes.length });
    this.worker.onerror = (event) => this.failed?.(event.message || "The page's worker did not start.");
  }

  /** Hand over views that have come in. */
  add(first, count) {
    const [height, width] = this.shape.size;
    const view = height * width * this.shape.channels;
    const codes = this.codes.slice(first * view, (first + count) * view);
    this.worker.postMessage({ codes, at: first * view }, [codes.buffer]);
  }

  /** Draw one picture at a time; of later requests only the last is kept. */
  async draw(picture) {
    this.next = picture;
    while (!this.busy && this.next) {
      this.busy = this.next;
      this.next = undefined;
      try {
        await this.finish(this.busy);
      } catch (error) {
        this.failed?.(error.message);
      }
      this.busy = undefined;
    }
  }

  async finish(picture) {
    const { parentElement } = this.canvas;
    const timer = setTimeout(() => (parentElement.ariaBusy = "true"), A_MOMENT);
    try {
      this.values = await this.sums(picture);
      paint(this.canvas, this.values, this.shape.size, this.shape.channels, picture.show);
    } finally {
      clearTimeout(timer);
      parentElement.ariaBusy = "false";
    }
    this.drawn?.();
  }

  sums({ slope, weights }) {
    this.worker.postMessage({ plan: planShifts(this.shape, slope, weights) });
    return new Promise((done) => (this.worker.onmessage = ({ data }) => done(data.image)));
  }

  /** The last image in units of full scale, as float32 (for tests). */
  read() {
    return this.values.map((x) => x / this.shape.levels);
  }

  close() {
    this.worker.terminate();
  }
}
