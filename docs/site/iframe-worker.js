// Browsers start no worker for a page from the disk, and the theme's search needs one. There a stand-in runs the
// worker's script in a hidden frame of the page, with the names that such a script expects.
"use strict";

function StandIn(address) {
  const worker = new EventTarget(), frame = document.createElement("iframe");
  const loaded = new Promise((done) => { frame.onload = done; });
  frame.hidden = true;
  document.body.append(frame);
  const added = (source) => new Promise((onload, onerror) => {
    const script = frame.contentDocument.createElement("script");
    frame.contentDocument.body.append(Object.assign(script, { src: source, onload, onerror }));
  });
  const ready = loaded.then(() => {
    frame.contentWindow.postMessage = (data) => {
      const said = new MessageEvent("message", { data });
      worker.dispatchEvent(said);
      worker.onmessage?.(said);
    };
    frame.contentWindow.importScripts = async (...sources) => { for (const source of sources) await added(source); };
    return added(address);
  });
  worker.postMessage = (data) => ready.then(() => frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })));
  worker.terminate = () => frame.remove();
  return worker;
}

if (location.protocol === "file:") window.Worker = StandIn;
