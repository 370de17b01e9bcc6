// Slow work, one piece at a time: of later requests only the last is kept.

import { paint } from "./display.js";

export class Latest {
  constructor(act, failed) {
    Object.assign(this, { act, failed });
  }

  ask(what) {
    this.next = what;
    this.advance();
  }

  async advance() {
    if (this.busy || !this.next) return;
    this.busy = this.next;
    this.next = undefined;
    try {
      await this.act(this.busy);
    } catch (error) {
      this.failed?.(error.message);
    }
    this.busy = undefined;
    this.advance();
  }
}

/** Milliseconds before the page says that it waits. */
const A_MOMENT = 400;

/** Draws what is summed elsewhere; make gives the values. */
export class LatestRenderer extends Latest {
  constructor(canvas, shape) {
    super((picture) => this.finish(picture));
    Object.assign(this, { canvas, shape });
  }

  draw(picture) {
    this.ask(picture);
  }

  async finish(picture) {
    const { parentElement } = this.canvas;
    const timer = setTimeout(() => (parentElement.ariaBusy = "true"), A_MOMENT);
    try {
      this.values = await this.make(picture);
      paint(this.canvas, this.values, this.shape.size, this.shape.channels, picture.show);
    } finally {
      clearTimeout(timer);
      parentElement.ariaBusy = "false";
    }
    this.drawn?.();
  }

  /** The last image in units of full scale, as float32 (for tests). */
  read() {
    return this.values.map((x) => x / this.shape.levels);
  }
}
