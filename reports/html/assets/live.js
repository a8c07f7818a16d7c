"use strict";
// Of a watched folder: shows how far the sweep is, and puts the content of a newer page into this one.
const LOOK_EVERY_MS = 2000;

async function lookForNewer() {
  if (document.hidden) return;
  const status = await fetched("status", (answer) => answer.json());
  if (!status) return;
  showProgress(status);
  if (status.version !== document.documentElement.dataset.version) await renew();
}

/** What the server answers; null if it has gone: the page stays as it is. */
async function fetched(path, read) {
  try {
    return await read(await fetch(path, { cache: "no-store" }));
  } catch {
    return null;
  }
}

/** `34 of 55, 3 s ago, about 6 min left` next to the title. */
function showProgress({ words }) {
  if (!words) return;
  let place = document.getElementById("progress");
  if (!place) {
    place = Object.assign(document.createElement("p"), { id: "progress", className: "live" });
    (document.querySelector(".page-head > div") || document.body).append(place);
  }
  place.textContent = words;
}

/**
 * Takes over what the newer page says and draws; scroll, theme, filters, what is open and what was searched for stay.
 */
async function renew() {
  const page = await fetched("update", (answer) => answer.text());
  if (page === null) return;
  const next = new DOMParser().parseFromString(page, "text/html");
  const data = next.querySelector("script[data-packed=data]");
  if (!data || typeof blocks === "undefined") {
    location.reload();
    return;
  } // there was no report before
  const text = await unpacked(data.textContent);
  const kept = keepPlace();
  for (const block of blocks) block.leave();
  for (const part of ["main", ".page-head h1", ".brief"])
    document.querySelector(part).replaceWith(document.adoptNode(next.querySelector(part)));
  document.querySelector(".notice")?.remove();
  const notice = next.querySelector(".notice");
  if (notice) document.body.prepend(document.adoptNode(notice));
  for (const key of Object.keys(DATA)) delete DATA[key];
  Object.assign(DATA, JSON.parse(text));
  setChoices();
  readAddress();
  start();
  for (const block of blocks) block.plan();
  kept();
  document.documentElement.dataset.version = next.documentElement.dataset.version;
}

/** Notes what is open, searched for and at the top of the window; returns what brings it back in the renewed page. */
function keepPlace() {
  const parts = () => [...document.querySelectorAll("main details")];
  const nameOf = (part) => {
    const within = part.closest("[id]") || document.querySelector("main");
    return part.id || `${within.id}: ${[...within.querySelectorAll("details")].indexOf(part)}`;
  };
  const open = new Map(parts().map((part) => [nameOf(part), part.open]));
  // The filters stay at the top of the window.
  const marks = () => [...document.querySelectorAll("main :is([id], h2, .headline):not(#filters, #filters *)")];
  const name = (mark) => mark.id || mark.textContent;
  const top = marks().find((mark) => mark.getClientRects().length && mark.getBoundingClientRect().top >= 0);
  const [topName, topAt] = top ? [name(top), top.getBoundingClientRect().top] : [null, 0];
  const search = document.getElementById("groups-search").value;
  const focus = document.activeElement?.id;
  return () => {
    for (const part of parts()) if (open.has(nameOf(part))) part.open = open.get(nameOf(part));
    if (search) {
      document.getElementById("groups-search").value = search;
      showGroups();
    }
    if (focus) document.getElementById(focus)?.focus({ preventScroll: true });
    const again = topName && marks().find((mark) => name(mark) === topName);
    if (again && scrollY > 0) scrollBy(0, again.getBoundingClientRect().top - topAt);
  };
}

lookForNewer();
setInterval(lookForNewer, LOOK_EVERY_MS);
document.addEventListener("visibilitychange", lookForNewer);
