// The viewer in a notebook (anywidget): views and slope map come as messages, the state is shared.

import { Viewer } from "./viewer.js";

/** What the notebook's side calls by other names than a page's state. */
const SHARED = { slope: "slope", aperture: "width", shape: "shape", viewpoint: "centre", region: "region" };

/** Ask Python for something, and wait for its answer. */
function asker(model) {
  const waiting = new Map();
  model.on("msg:custom", ({ answer }, buffers) => {
    const [buffer] = buffers;
    const bytes = new Uint8Array(buffer.buffer ?? buffer, buffer.byteOffset ?? 0, buffer.byteLength);
    waiting.get(answer)?.(bytes.slice().buffer);
    waiting.delete(answer);
  });
  return (name) =>
    new Promise((resolve) => {
      waiting.set(name, resolve);
      model.send({ ask: name });
    });
}

const same = (one, other) => JSON.stringify(one) === JSON.stringify(other);

function render({ model, el }) {
  const ask = asker(model);
  const metadata = { ...model.get("metadata") };
  const source = {
    piece: (number) => ask(`views/${number}`),
    slopeMap: metadata.has_map && (() => ask("map")),
  };
  const viewer = new Viewer(el, metadata, source);
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
