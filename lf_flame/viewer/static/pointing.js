// Places and boxes in the picture: by mouse, finger or keys.

const MOVES = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

export class Pointing {
  constructor(viewer) {
    this.viewer = viewer;
    this.canvas = viewer.find(".lf-over");
    this.canvas.style.touchAction = "none";
    this.canvas.addEventListener("pointerdown", (event) => this.begin(event));
    this.canvas.addEventListener("pointermove", (event) => this.move(event));
    this.canvas.addEventListener("pointerup", (event) => this.end(event));
    this.canvas.addEventListener("pointercancel", () => (this.from = undefined));
    this.canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** Row and column under the pointer. */
  at(event) {
    const box = this.canvas.getBoundingClientRect();
    const [height, width] = this.viewer.metadata.size;
    const clamp = (x, n) => Math.min(Math.max(Math.floor(x * n), 0), n - 1);
    return [
      clamp((event.clientY - box.top) / box.height, height),
      clamp((event.clientX - box.left) / box.width, width),
    ];
  }

  begin(event) {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.from = this.at(event);
  }

  move(event) {
    const here = this.at(event);
    this.viewer.hint(here);
    this.viewer.slicesAt(...here);
    if (this.from && this.isBox(here)) this.viewer.set({ region: this.box(here) });
  }

  end(event) {
    if (!this.from) return;
    const here = this.at(event);
    if (this.isBox(here)) this.viewer.focusOn(this.box(here));
    else {
      this.place = here;
      this.viewer.focusAt(...here);
    }
    this.from = undefined;
    this.viewer.draw();
  }

  isBox(here) {
    const shaky = Math.max(2, (8 * this.canvas.width) / this.canvas.clientWidth); // as fingers are
    const moved = here.some((x, axis) => Math.abs(x - this.from[axis]) > shaky);
    return moved && !this.viewer.metadata.depths_mm;
  }

  box(here) {
    return [0, 1].flatMap((axis) => {
      const ends = [this.from[axis], here[axis]].sort((a, b) => a - b);
      return [ends[0], ends[1] + 1];
    });
  }

  key(event) {
    const { size } = this.viewer.metadata;
    const move = MOVES[event.key];
    if (move) {
      const step = event.shiftKey ? 10 : 1;
      const from = this.place ?? size.map((n) => n >> 1);
      this.place = from.map((x, axis) => Math.min(Math.max(x + step * move[axis], 0), size[axis] - 1));
      this.viewer.slicesAt(...this.place);
      this.viewer.hint(this.place);
      this.viewer.draw();
    } else if (event.key === "Enter" && this.place) this.viewer.focusAt(...this.place);
    else if (event.key === "Escape") this.viewer.set({ region: null });
    else return;
    event.preventDefault();
  }
}
