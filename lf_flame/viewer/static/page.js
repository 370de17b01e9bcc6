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

globalThis.lfViewer = viewer;
