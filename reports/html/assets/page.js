"use strict";
// The page comes to life: theme, filters, figures, tables.

let blocks = [];

/** What the reader chose has changed: figures, filters and table follow. */
function refreshAll() {
  showFilters();
  showCellChoice();
  const tableNow = isOnScreen(document.getElementById("groups-table"));
  if (tableNow) showGroups();
  redraw(tableNow ? [] : [() => showGroups()]);
}

let redrawing = 0;

/** Draws what the reader sees now and does the rest in small steps, for which neither he nor the next change waits. */
function redraw(more = []) {
  for (const block of blocks) block.spoil();
  for (const block of blocks) if (isOnScreen(block.plot)) block.draw(isOnScreen);
  redrawing += 1;
  const job = redrawing;
  const rest = [...blocks.map((block) => () => block.plan()), ...more, drawNear];
  requestAnimationFrame(() => later(rest, job)); // not before the reader sees what is drawn
}

/** Draws the rows that are near the window, each in a turn of its own. */
function drawNear() {
  later(
    blocks.flatMap((block) =>
      [...block.plot.children].filter((row) => NEAR.has(row)).map((row) => () => block.draw((one) => one === row)),
    ),
  );
}

/** One step a turn of the event loop, until a newer change has steps of its own. */
function later([step, ...rest], job = redrawing) {
  if (!step) return;
  setTimeout(() => {
    if (job !== redrawing) return;
    step();
    later(rest, job);
  });
}

function change(apply) {
  apply();
  writeAddress();
  refreshAll();
}

// Filters: one menu of checkboxes each, then the selectors that say what is drawn.

function filterMenu(filter) {
  const details = element("details", { class: "filter", "data-filter": filter.key });
  const summary = element("summary");
  const fieldset = element("fieldset", {}, element("legend", { class: "unseen" }, filter.label));
  filter.options.forEach((option, place) => {
    const box = element("input", { type: "checkbox", value: option.value });
    box.addEventListener("change", () => change(() => choose(filter, place, box.checked)));
    fieldset.append(element("label", {}, box, option.label));
  });
  details.append(summary, fieldset);
  details.addEventListener("toggle", () => closeOthers(details));
  return details;
}

/** Nothing checked and everything checked both mean: all. */
function choose(filter, place, checked) {
  const places = new Set(view.chosen[filter.key] || []);
  if (checked) places.add(place);
  else places.delete(place);
  if (places.size === 0 || places.size === filter.options.length) delete view.chosen[filter.key];
  else view.chosen[filter.key] = places;
}

function selector(name, label) {
  const select = element("select", { id: `choose-${name}` });
  for (const choice of CHOICES[name])
    select.append(element("option", { value: choice.key }, choice.menu || choice.label));
  select.addEventListener("change", () =>
    change(() => {
      view[name] = select.value;
    }),
  );
  return element("label", {}, label, select);
}

const MOST_MENUS = 5; // in the row; the others are in its last menu
const FIRST_MENUS = ["vendor", "bridge", "data", "size", "rate", "device", "link"];

/** A menu of what is rarely chosen. */
function moreMenu(parts) {
  const details = element(
    "details",
    { class: "filter", id: "more" },
    element("summary", {}, "More"),
    element("fieldset", {}, element("legend", { class: "unseen" }, "More choices"), ...parts),
  );
  details.addEventListener("toggle", () => closeOthers(details));
  return details;
}

function closeOthers(details) {
  if (!details.open) return;
  for (const other of document.querySelectorAll(".filter[open]")) if (!other.contains(details)) other.open = false;
}

function buildFilters() {
  const form = document.getElementById("filters");
  const reset = element("button", { type: "button", class: "quiet", id: "reset" }, "Show all");
  reset.addEventListener("click", () =>
    change(() => {
      view.chosen = {};
    }),
  );
  const first = FIRST_MENUS.flatMap((key) => DATA.filters.filter((filter) => filter.key === key)).slice(0, MOST_MENUS);
  const others = DATA.filters.filter((filter) => !first.includes(filter));
  form.append(
    ...first.map(filterMenu),
    selector("metric", "Metric"),
    selector("statistic", "Statistic"),
    moreMenu([
      ...others.map(filterMenu),
      selector("scale", "Scale"),
      selector("panels", "Panels by"),
      selector("lines", "Lines by"),
      selector("bars", "Bars over"),
    ]),
    reset,
    element("span", { class: "count", role: "status" }),
    element("span", { class: "note of-all", id: "of-all", hidden: "" }, "The answer and its table are of all results."),
  );
  const spreading = element("p", { class: "choice", id: "spreading" });
  const paper = element("button", { type: "button", class: "quiet", id: "paper" }, "The paper's figures");
  paper.addEventListener("click", () => {
    const on = isPaper();
    change(() => choosePaper(!on));
    if (on) return;
    for (const block of blocks) if (PAPER_FIGURES.includes(block.name)) block.fold.open = true;
  });
  spreading.append(paper);
  document.getElementById("figures-title").after(spreading);
  // What the tiles of the heatmap show is selected above it.
  document
    .querySelector("#figure-heatmap .legend")
    ?.before(element("p", { class: "choice" }, selector("tiles", "Tiles show ")));
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("keydown", (event) => {
    const menu = event.key === "Escape" && event.target.closest(".filter[open]");
    if (!menu) return;
    menu.open = false;
    menu.querySelector("summary").focus();
  });
}

document.addEventListener("click", (event) => {
  for (const menu of document.querySelectorAll(".filter[open]")) if (!menu.contains(event.target)) menu.open = false;
});

function showFilters() {
  const paper = document.getElementById("paper");
  paper.hidden = !paperChoices().length || !blocks.some((block) => PAPER_FIGURES.includes(block.name));
  paper.setAttribute("aria-pressed", String(isPaper()));
  for (const filter of DATA.filters) {
    const menu = document.querySelector(`[data-filter="${filter.key}"]`);
    const places = view.chosen[filter.key];
    menu.classList.toggle("active", Boolean(places));
    const chosen = places ? filter.options.filter((_, place) => places.has(place)).map((option) => option.label) : [];
    menu.querySelector("summary").textContent = places
      ? `${filter.label}: ` +
        (chosen.length === 1 ? shorten(chosen[0], 24) : `${chosen.length} of ${filter.options.length}`)
      : filter.label;
    menu.querySelectorAll("input").forEach((box, place) => {
      box.checked = Boolean(places && places.has(place));
    });
  }
  for (const name of Object.keys(CHOICES)) {
    const select = document.getElementById(`choose-${name}`);
    if (select) select.value = view[name];
  }
  const choosesMore = ["scale", "panels", "lines", "bars"].some((name) => view[name] !== CHOICES[name][0].key);
  const more = document.getElementById("more");
  more.classList.toggle("active", choosesMore || Boolean(more.querySelector(".filter.active")));
  const isWhole = Object.keys(view.chosen).length === 0;
  for (const part of [...document.querySelectorAll(".of-all"), document.getElementById("reset")]) part.hidden = isWhole;
  const passing = passingGroups().length;
  document.querySelector(".count").textContent =
    `${passing === DATA.groups.count ? "" : `${formatCount(passing)} of `}${counted(DATA.groups.count, "result")}`;
}

/** Which message the detail figures show, out of those that pass the filters. */
function showCellChoice() {
  const cells = [...new Set(passingGroups().map((group) => DATA.groups.cell[group]))].sort((a, b) => a - b);
  const select = element(
    "select",
    { id: "choose-cell" },
    ...cells.map((cell) => element("option", { value: String(cell) }, DATA.cells[cell].label)),
  );
  select.value = String(shownCell());
  select.addEventListener("change", () => {
    change(() => {
      view.cell = Number(select.value);
    });
    document.getElementById("choose-cell").focus();
  });
  const label = element("label", { for: "choose-cell" }, "Messages: ");
  const places = placesOfCell();
  const where = element(
    "select",
    { id: "choose-place" },
    ...places.map((place) => element("option", { value: String(place) }, DATA.dimensions.place.options[place].label)),
  );
  where.value = String(shownPlace());
  where.addEventListener("change", () => {
    change(() => {
      view.place = Number(where.value);
    });
    document.getElementById("choose-place").focus();
  });
  const on = places.length > 1 ? [element("label", { for: "choose-place" }, " on "), where] : [];
  document.getElementById("cell-choice").replaceChildren(...(cells.length ? [label, select, ...on] : []));
}

// The address contains the view, so a link within the page must not replace it.

document.addEventListener("click", (event) => {
  const link = event.target.closest("a[href^='#']:not([data-group])");
  const target = link && document.getElementById(link.getAttribute("href").slice(1));
  if (!target) return;
  event.preventDefault();
  if (target.tagName === "DETAILS") target.open = true;
  for (const block of blocks) block.plan(); // what has not taken its room yet would push the target away
  const focused = target.querySelector(":scope > summary") || target;
  if (focused === target) target.tabIndex = -1;
  target.scrollIntoView();
  focused.focus({ preventScroll: true });
});

addEventListener("hashchange", () => {
  readAddress();
  refreshAll();
  showGroup();
});

let width = innerWidth;
let resized;
addEventListener("resize", () => {
  clearTimeout(resized);
  resized = setTimeout(() => {
    if (innerWidth === width) return;
    width = innerWidth;
    redraw();
  }, 150);
});

/** Everything that depends on the data and the content of `main`; again when a watched page is renewed. */
function start() {
  blocks = [...document.querySelectorAll("[data-figure]")].map((article) => new FigureBlock(article));
  buildFilters();
  buildPictureBar();
  document.getElementById("save-parquet").addEventListener("click", saveParquet);
  document.getElementById("groups-search").addEventListener("input", () => showGroups());
  document.getElementById("all-columns").addEventListener("change", () => showGroups());
  document.getElementById("save-groups").addEventListener("click", () => {
    const { columns, rows } = showGroups();
    saveCsv("dds-trace-groups", columns, rows);
  });
  refreshAll();
  buildJob();
  showGroup();
}

readAddress();
showTheme();
start();
addEventListener("theme", () => redraw());
const printed = new URLSearchParams(location.search).get("figures"); // mm: `analyze --figures` prints the page
if (printed) for (const format of ["tex", "pdf"]) saveAll(format, { mm: Number(printed), dialog: false });
