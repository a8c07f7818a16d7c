"use strict";
// Data, plotly.js and the page's own scripts are packed (gzip in base64). They are unpacked here and run under the
// hashes of the page's policy: an inserted script needs its hash there like any other.
const UNPACKED = {};

async function unpacked(text) {
  const packed = atob(text);
  const bytes = new Uint8Array(packed.length);
  for (let place = 0; place < packed.length; place += 1) bytes[place] = packed.charCodeAt(place);
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

(async () => {
  const parts = [...document.querySelectorAll("script[data-packed]")];
  const texts = await Promise.all(parts.map((part) => unpacked(part.textContent)));
  parts.forEach((part, place) => {
    if (part.dataset.packed === "data") UNPACKED.data = texts[place];
    else document.body.append(Object.assign(document.createElement("script"), { textContent: texts[place] }));
  });
})().catch((error) => {
  const said = document.getElementById("cannot-unpack");
  said.hidden = false;
  said.append(` (${error.message})`);
});
