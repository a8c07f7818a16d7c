"use strict";
// What the reader chose to see. It lives in the page's address: a view can be linked, and Back leads to the last one.
const SCALES = [
  { key: "log", label: "log" },
  { key: "linear", label: "linear" },
];
const TILES = [
  { key: "statistic", label: "the chosen metric" },
  { key: "received_ratio", label: "messages received" },
  { key: "transfer_rate_bytes_per_s", label: "transfer rate" },
];
const AUTO = { key: "auto", label: "as each figure proposes" };
const CHOICES = {};

/** What can be chosen from the page's data; called again when a watched page gets newer data. */
function setChoices() {
  Object.assign(CHOICES, {
    metric: DATA.metrics.length ? DATA.metrics : [{ key: "latency", label: "Latency" }],
    statistic: DATA.statistics,
    scale: SCALES,
    tiles: TILES,
    // What is side by side and what is a line; `auto` is what each figure proposes.
    panels: [AUTO, ...dimensionChoices(["size", "rate", "vendor", "way", "device", "link"])],
    lines: [AUTO, ...dimensionChoices(["choice", "size", "rate", "vendor", "way", "device", "link"])],
    bars: [
      { key: "size", label: "size" },
      { key: "rate", label: "frequency" },
    ],
  });
}
setChoices();

/** The dimensions in which groups differ, as choices. */
function dimensionChoices(keys) {
  return keys
    .filter((key) => DATA.dimensions[key].options.length > 1)
    .map((key) => ({ key, label: DATA.dimensions[key].label }));
}

const PAPER_FIGURES = ["latency_by_rate", "domain_difference"];
/** The paper's figures: a panel for each middleware, bridge and device, a line per size; bars of both domains. */
const PAPER = { panels: "vendor", lines: "size", bars: "size" };

const view = {
  chosen: {}, // filter key -> Set of option places; a key that is not there means all
  group: null, // the one that is open
  only: null, // while only one group is drawn
  cell: null, // place in DATA.cells, or null for the first that passes
  place: null, // place among the options of the dimension place, or null for the first of the cell
  hidden: new Set(), // lines that the reader switched off in a legend, as `dimension/option`
};

/** What the paper chooses that this campaign has and that the page does not choose anyway. */
const paperChoices = () =>
  Object.entries(PAPER).filter(([name, key]) => CHOICES[name].findIndex((choice) => choice.key === key) > 0);

function isPaper() {
  const chosen = paperChoices();
  return chosen.length > 0 && view.bars === PAPER.bars && chosen.every(([name, key]) => view[name] === key);
}

function choosePaper(on) {
  for (const [name, key] of Object.entries(PAPER))
    view[name] = on && CHOICES[name].some((choice) => choice.key === key) ? key : CHOICES[name][0].key;
}

function readAddress() {
  const address = new URLSearchParams(location.hash.slice(1));
  view.chosen = {};
  for (const filter of DATA.filters) {
    const wanted = address.getAll(filter.key);
    const places = filter.options.flatMap((option, place) => (wanted.includes(option.value) ? [place] : []));
    if (places.length) view.chosen[filter.key] = new Set(places);
  }
  for (const [name, choices] of Object.entries(CHOICES)) {
    const found = choices.find((choice) => choice.key === address.get(name));
    view[name] = (found || choices[0]).key;
  }
  const named = address.get("group");
  const group =
    named === null
      ? -1
      : Array.from({ length: DATA.groups.count }, (_, place) => place).findIndex((place) => groupName(place) === named);
  view.group = group < 0 ? null : group;
  const cell = DATA.cells.findIndex((one) => one.label === address.get("cell"));
  view.cell = cell < 0 ? null : cell;
  const place = DATA.dimensions.place.options.findIndex((one) => one.label === address.get("place"));
  view.place = place < 0 ? null : place;
}

function writeAddress() {
  const address = new URLSearchParams();
  for (const filter of DATA.filters) {
    for (const place of view.chosen[filter.key] || []) address.append(filter.key, filter.options[place].value);
  }
  for (const [name, choices] of Object.entries(CHOICES)) {
    if (view[name] !== choices[0].key) address.set(name, view[name]);
  }
  if (view.cell !== null) address.set("cell", DATA.cells[view.cell].label);
  if (view.group !== null) address.set("group", groupName(view.group));
  if (view.place !== null) address.set("place", DATA.dimensions.place.options[view.place].label);
  const text = address.toString();
  if (text !== location.hash.slice(1)) history.pushState(null, "", `#${text}`); // so Back undoes a choice
}

/** Whether the group passes every filter. */
function passes(group) {
  if (view.only !== null) return group === view.only;
  return Object.entries(view.chosen).every(([key, places]) => places.has(DATA.groups.filters[key][group]));
}

function passingGroups() {
  return Array.from({ length: DATA.groups.count }, (_, group) => group).filter(passes);
}

/** The cell that the detail figures show: the chosen one if it passes, else the one that most series share. */
function shownCell() {
  const counts = new Map();
  for (const group of passingGroups()) {
    const cell = DATA.groups.cell[group];
    counts.set(cell, (counts.get(cell) || 0) + 1);
  }
  if (counts.has(view.cell)) return view.cell;
  const most = Math.max(...counts.values());
  return [...counts.keys()].sort((a, b) => a - b).find((cell) => counts.get(cell) === most) ?? null;
}

/** Where the cell was measured: places of DATA.dimensions.place, and the one that the detail figures show. */
function placesOfCell() {
  const cell = shownCell();
  const places = passingGroups()
    .filter((group) => DATA.groups.cell[group] === cell)
    .map((group) => DATA.dimensions.place.index[group]);
  return [...new Set(places)].sort((a, b) => a - b);
}
function shownPlace() {
  const places = placesOfCell();
  return places.includes(view.place) ? view.place : (places[0] ?? null);
}

/** The groups of the detail figures. */
function cellGroups() {
  const [cell, place] = [shownCell(), shownPlace()];
  return passingGroups().filter(
    (group) => DATA.groups.cell[group] === cell && DATA.dimensions.place.index[group] === place,
  );
}

/** A percentile (the chosen one) of a typical run in ns; null with fewer than three runs. */
function typicalOf(group, statistic = view.statistic, metric = view.metric) {
  return DATA.intervals.typical_ns[metric]?.[statistic]?.[group] ?? null;
}

/** The chosen statistic of the chosen metric, in ns, or null: of what its interval is of. */
function statisticOf(group, metric = view.metric) {
  return typicalOf(group, view.statistic, metric) ?? DATA.values.times_ns[metric][view.statistic][group];
}

/** Whose chosen statistic the marks show. */
function ofWhom() {
  const groups = passingGroups();
  const typical = new Set(groups.map((group) => typicalOf(group) !== null));
  const isWhole = groups.every((group) => DATA.values.plain.received_ratio[group] === 1);
  const [run, all] = isWhole
    ? ["a typical run", "all messages"]
    : ["a typical run's received messages", "all received messages"];
  return typical.size > 1 ? `${run} or ${all}` : typical.has(true) ? run : all;
}

/** [low, high] of a percentile's 95 % interval (the chosen one's), each null where the sample does not support it. */
function intervalOf(group, statistic = view.statistic) {
  const end = (side) => DATA.intervals[side][view.metric]?.[statistic]?.[group] ?? null;
  return [end("low_ns"), end("high_ns")];
}

/** What the interval of a percentile rests on, as a sentence; empty without an interval. */
function restsOn(group, statistic = view.statistic) {
  return DATA.intervals.rests_on[view.metric]?.[statistic]?.[group] ?? "";
}

const labelOf = (name) => CHOICES[name].find((choice) => choice.key === view[name]).label;
function statisticLabel() {
  return `${labelOf("metric")}, ${labelOf("statistic")}`;
}
