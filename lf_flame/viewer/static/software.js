// Draws refocused images without WebGL2: a Worker sums, the page goes on answering meanwhile.

import { planShifts } from "./shifts.js";
import { showable } from "./display.js";

/** Codes that are summed in about 50 ms; with more of them, dragging shows binned images. */
const AT_ONCE = 8e6;

export class SoftwareRenderer {
  constructor(canvas, shape, codes) {
    Object.assign(this, { canvas, shape, codes, name: "JavaScript" });
    this.block = Math.ceil(Math.sqrt(codes.length / AT_ONCE));
    this.worker = new Worker(new URL(import.meta.resolve("./sums.js")), { type: "module" });
    const wide = codes instanceof Uint16Array;
    this.worker.postMessage({ shape, wide, length: codes.length });
    this.worker.onmessage = ({ data }) => this.finish(data);
    this.worker.onerror = (event) => this.failed?.(event.message || "The page's worker did not start.");
  }

  /** Hand over views that have come in. */
  add(first, count) {
    const [height, width] = this.shape.size;
    const view = height * width * this.shape.channels;
    const codes = this.codes.slice(first * view, (first + count) * view);
    this.worker.postMessage({ codes, at: first * view }, [codes.buffer]);
  }

  /** Ask for an image; while one is being summed, only the last one asked for is kept. */
  draw(picture) {
    this.next = picture;
    this.advance();
  }

  advance() {
    if (this.busy || !this.next) return;
    this.busy = this.next;
    this.next = undefined;
    const { slope, weights, dragging } = this.busy;
    const block = dragging ? this.block : 1;
    const size = this.shape.size.map((n) => Math.floor(n / block));
    const plan = planShifts({ positions: this.shape.positions, size }, slope / block, weights);
    this.worker.postMessage({ plan, block });
  }

  finish({ image, size }) {
    const [height, width] = size;
    const { show } = this.busy;
    this.busy = undefined;
    this.values = image;
    Object.assign(this.canvas, { height, width });
    const levels = showable(image, this.shape.channels, show);
    this.canvas.getContext("2d").putImageData(new ImageData(levels, width, height), 0, 0);
    this.drawn?.();
    this.advance();
  }

  /** The last image in units of full scale, as float32 (for tests). */
  read() {
    return this.values.map((x) => x / this.shape.levels);
  }

  close() {
    this.worker.terminate();
  }
}
