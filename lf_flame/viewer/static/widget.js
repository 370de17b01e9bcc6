// The viewer in a notebook (anywidget): views come as messages.

import { asked } from "./source.js";
import { Viewer } from "./viewer.js";

/** What the notebook's side calls by other names than a page's state. */
const SHARED = { slope: "slope", aperture: "width", shape: "shape", viewpoint: "centre", region: "region" };

/** Ask Python for something, and wait for its answer. */
function asker(model) {
  const waiting = new Map();
  model.on("msg:custom", ({ answer, error }, [buffer]) => {
    const [resolve, reject] = waiting.get(answer) ?? [];
    waiting.delete(answer);
    if (error) reject?.(new Error(error));
    else if (buffer) {
      const bytes = new Uint8Array(buffer.buffer ?? buffer, buffer.byteOffset ?? 0, buffer.byteLength);
      resolve?.(bytes.slice().buffer);
    }
  });
  return (name) =>
    new Promise((...ends) => {
      waiting.set(name, ends);
      model.send({ ask: name });
    });
}

const same = (one, other) => JSON.stringify(one) === JSON.stringify(other);

function render({ model, el }) {
  const metadata = { ...model.get("metadata") };
  el.addEventListener("keydown", (event) => event.stopPropagation()); // else JupyterLab takes arrows
  const viewer = new Viewer(el, metadata, asked(asker(model), metadata));
  const take = () => {
    const changes = {};
    for (const [name, field] of Object.entries(SHARED)) {
      const value = model.get(name);
      if (!same(value, viewer.state[field])) changes[field] = value;
    }
    if (Object.keys(changes).length) viewer.set(changes);
  };
  take();
  for (const name of Object.keys(SHARED)) model.on(`change:${name}`, take);
  viewer.listeners.push((state) => {
    const before = Object.keys(SHARED).filter((name) => !same(model.get(name), state[SHARED[name]]));
    for (const name of before) model.set(name, state[SHARED[name]]);
    if (before.length) model.save_changes();
  });
  globalThis.lfViewer = viewer;
  return () => viewer.close();
}

export default { render };
