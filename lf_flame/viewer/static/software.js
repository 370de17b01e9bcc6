// Draws without WebGL2: a Worker sums, the page goes on answering meanwhile.

import { LatestRenderer } from "./latest.js";
import { planShifts } from "./shifts.js";

export class SoftwareRenderer extends LatestRenderer {
  constructor(canvas, shape, codes) {
    super(canvas, shape);
    Object.assign(this, { codes, name: "JavaScript" });
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

  make({ slope, weights }) {
    this.worker.postMessage({ plan: planShifts(this.shape, slope, weights) });
    return new Promise((done) => (this.worker.onmessage = ({ data }) => done(data.image)));
  }

  close() {
    this.worker.terminate();
  }
}
