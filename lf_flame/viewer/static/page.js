// A page with one viewer, which keeps the state in the address.

import { asked, embedded, fetcher } from "./source.js";
import { fromAddress, toAddress } from "./state.js";
import { Viewer } from "./viewer.js";

const read = (id) => document.getElementById(id)?.textContent;
const metadata = JSON.parse(read("lf-metadata"));
const source = metadata.coding === "served"
  ? asked(fetcher(document.baseURI), metadata)
  : embedded(read, metadata);
const query = new URLSearchParams(location.search);
const options = { address: location.hash, renderer: query.get("renderer") };
const viewer = new Viewer(document.getElementById("lf-viewer"), metadata, source, options);

let waiting;
function keepInAddress(state) {
  clearTimeout(waiting); // browsers refuse an address that changes too often
  waiting = setTimeout(() => {
    const address = toAddress(state, viewer.first);
    history.replaceState(null, "", address ? `#${address}` : location.pathname + location.search);
  }, 200);
}
// Inside another page, as in a report, there is no address of one's own.
if (location.protocol !== "about:") viewer.listeners.push(keepInAddress);
addEventListener("hashchange", () => viewer.set(fromAddress(location.hash, viewer.first, metadata)));

/** Frames a second of this browser, with all views. */
async function benchmark() {
  await viewer.ready;
  const { renderer, state } = viewer;
  const [low, high] = metadata.slopes;
  let frames = 0;
  const begin = performance.now();
  while (performance.now() - begin < 3000) {
    const slope = low + ((high - low) * (frames % 50)) / 49;
    await new Promise((resolve) => {
      viewer.onDrawn = resolve;
      viewer.state = { ...state, slope };
      viewer.draw(true);
    });
    renderer.wait?.();
    frames += 1;
  }
  viewer.onDrawn = undefined;
  viewer.set(state);
  const rate = (1000 * frames) / (performance.now() - begin);
  viewer.say(`${rate.toFixed(1)} frames a second, drawn by ${renderer.name}`);
  return rate;
}

globalThis.lfViewer = viewer;
if (query.has("bench")) viewer.benchmark = benchmark();
