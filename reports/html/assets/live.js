"use strict";
// Of a watched folder: the page loads itself again, with the view it has, once the server has a newer one.
const LOOK_EVERY_MS = 10000;

async function lookForNewer() {
  if (document.hidden) return;
  try {
    const answer = await fetch("version", { cache: "no-store" });
    if (answer.ok && (await answer.text()) !== document.documentElement.dataset.version) location.reload();
  } catch {
    // The server has gone; the page stays as it is.
  }
}

setInterval(lookForNewer, LOOK_EVERY_MS);
document.addEventListener("visibilitychange", lookForNewer);
