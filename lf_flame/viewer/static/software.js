// Draws without WebGL2: a Worker sums, the page goes on answering meanwhile.

import { LatestRenderer } from "./latest.js";
import { planShifts } from "./shifts.js";

/** Codes that are summed in about 50 ms; with more of them, dragging shows binned images. */
const AT_ONCE = 8e6;

export class SoftwareRenderer extends LatestRenderer {
  constructor(canvas, shape, codes) {
    super(canvas, shape);
    Object.assign(this, { codes, name: "JavaScript" });
    this.block = Math.ceil(Math.sqrt(codes.length / AT_ONCE));
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

  make({ slope, weights, dragging }) {
    const block = dragging ? this.block : 1;
    const size = this.shape.size.map((n) => Math.floor(n / block));
    const plan = planShifts({ positions: this.shape.positions, size }, slope / block, weights);
    this.worker.postMessage({ plan, block });
    return new Promise((done) => {
      this.worker.onmessage = ({ data }) => done({ values: data.image, size });
    });
  }

  close() {
    this.worker.terminate();
  }
}
