// Draws images that the program makes: large ones, by a network, or exactly.

import { LatestRenderer } from "./latest.js";

/** Milliseconds; where a whole image takes longer, dragging shows coarser ones. */
const PATIENCE = 100;

export class PlaneRenderer extends LatestRenderer {
  /** source: of source.js; coarse: side of the blocks that are averaged while one drags. */
  constructor(canvas, shape, source, coarse) {
    super(canvas, shape);
    Object.assign(this, { source, coarse, name: "the program", took: 0 });
  }

  async begin(show) {
    const values = new Float32Array(await this.source.middle());
    if (!this.values) this.show(values, this.shape.size, show);
  }

  async make({ slope, aperture, dragging }) {
    const block = dragging && this.took > PATIENCE ? this.coarse : 1;
    const { shape, width, ring, centre } = aperture;
    const [v, u] = centre;
    const query = String(new URLSearchParams({ slope, shape, width, ring, v, u, block }));
    if (query === this.query) return this.made; // gain and gamma alone have changed
    const begin = performance.now();
    const values = new Float32Array(await this.source.plane(query));
    if (block === 1) this.took = performance.now() - begin;
    const size = this.shape.size.map((n) => Math.floor(n / block));
    if (values.length !== size[0] * size[1] * this.shape.channels) throw new Error("This picture is damaged.");
    this.query = query;
    return (this.made = { values, size });
  }

  close() {}
}
