"use strict";
// Tables whose columns sort. A column is {label, unit?, format?}; a number is shown by `format`, sorted as it is.
const MOST_ROWS = 2000;

function compareCells(a, b) {
  const missing = (value) => value === null || value === undefined;
  if (missing(a) || missing(b)) return missing(a) - missing(b);
  return typeof a === "number" && typeof b === "number"
    ? a - b
    : String(a).localeCompare(String(b), "en", { numeric: true });
}

function isNumeric(rows, column) {
  return rows.some((row) => typeof row[column] === "number");
}

const FIRST_ROWS = 25,
  ROWS_A_STEP = 80; // shown at once, and added while the reader reads them

/**
 * Puts the table into `place`. `sorting` {column, descending} survives when filters change the rows; the first `stay`
 * columns stay when the rest is scrolled sideways; a row with a `group` opens it.
 */
function showTable(
  place,
  caption,
  columns,
  rows,
  { sorting = { column: -1, descending: false }, stay = 0, most = MOST_ROWS } = {},
) {
  // A column without any value is left to the CSV file.
  const seen = columns.map(
    ({ stays, isLeft }, at) =>
      !isLeft && (stays || at < stay || !rows.length || rows.some((row) => (row[at] ?? "") !== "")),
  );
  if (seen.includes(false)) {
    const kept = (list) => Object.assign(list.filter((_, at) => seen[at]), { size: list.size, group: list.group });
    return showTable(place, caption, kept(columns), rows.map(kept), { sorting, stay, most });
  }
  const sorted = [...rows];
  if (sorting.column >= 0) {
    const sign = sorting.descending ? -1 : 1;
    sorted.sort((a, b) => {
      const [left, right] = [a[sorting.column], b[sorting.column]];
      // Missing values stay last whichever way the column is sorted.
      const absent = (left === null || left === undefined) - (right === null || right === undefined);
      return absent || sign * compareCells(left, right);
    });
  }
  const head = element("tr");
  const numeric = columns.map((_, column) => isNumeric(rows, column));
  columns.forEach((column, place_) => {
    const button = element("button", { type: "button" }, column.label);
    const cell = element("th", { scope: "col" }, button);
    if (numeric[place_]) cell.className = "number";
    if (sorting.column === place_) cell.setAttribute("aria-sort", sorting.descending ? "descending" : "ascending");
    button.addEventListener("click", () => {
      const again = sorting.column === place_;
      Object.assign(sorting, { column: place_, descending: again && !sorting.descending });
      showTable(place, caption, columns, rows, { sorting, stay });
      place.querySelectorAll("thead button")[place_].focus();
    });
    head.append(cell);
  });
  const body = element("tbody");
  const table = element(
    "table",
    { class: "data", "data-stay": stay },
    element("caption", { class: "unseen" }, caption),
    element("thead", {}, head),
    body,
  );
  const before = place.querySelector("table");
  if (before && stay) {
    table.className = before.className;
    table.style.cssText = before.style.cssText;
  } // its columns stay, most likely
  const scroll = element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption }, table);
  const left = rows.length - most;
  const notes =
    left > 0 ? [element("p", { class: "note" }, `${formatCount(left)} more rows are in the CSV file.`)] : [];
  const shown = sorted.slice(0, most);
  const texts = shown.map((row) => columns.map((column, at) => cellText(column, row, at)));
  const first = most < MOST_ROWS ? shown.length : FIRST_ROWS;
  // The columns are at once as wide as they will be, so that nothing moves when rows are added.
  if (shown.length > first) columns.forEach((_, at) => head.children[at].append(roomFor(texts.map((row) => row[at]))));
  const add = (from, to) =>
    body.append(...shown.slice(from, to).map((row, at) => tableRow(texts[from + at], row, numeric)));
  place.replaceChildren(scroll, ...notes);
  add(0, first);
  keepColumns(scroll, stay);
  const more = (from) =>
    setTimeout(() => {
      if (!body.isConnected) return; // another table has taken its place
      add(from, from + ROWS_A_STEP);
      if (from + ROWS_A_STEP < shown.length) more(from + ROWS_A_STEP);
    });
  if (shown.length > first) more(first);
}

function cellText(column, row, at) {
  const value = row[at];
  return value === null || value === undefined
    ? MISSING
    : typeof value === "number" && column.format
      ? column.format(value, row)
      : String(value);
}

const RULER = document.createElement("canvas").getContext("2d");
const WIDTHS = new Map(); // text, its digits as zeros -> px in a table

/** An element without height that is as wide as the widest text; digits are of one width in tables. */
function roomFor(texts) {
  const size = parseFloat(getComputedStyle(document.documentElement).fontSize);
  RULER.font = `${0.875 * size}px ${getComputedStyle(document.body).fontFamily}`;
  let most = 0;
  for (const text of texts) {
    const pattern = text.replace(/\d/g, "0");
    if (!WIDTHS.has(pattern)) WIDTHS.set(pattern, RULER.measureText(pattern).width);
    most = Math.max(most, WIDTHS.get(pattern));
  }
  const room = element("span", { class: "room" });
  room.style.width = `${Math.ceil(most)}px`;
  return room;
}

function tableRow(texts, row, numeric) {
  const line = element("tr", row.group === undefined ? {} : { "data-group": row.group });
  texts.forEach((shown, at) => {
    // The last of what names the group is the button that opens it; the whole row does so for a pointer.
    const opens = row.group !== undefined && at === GROUP_COLUMNS.length - 1;
    const cell = element(
      "td",
      numeric[at] ? { class: "number" } : {},
      opens ? element("button", { type: "button", class: "opens" }, shown) : shown,
    );
    if (shown.length > 40) cell.title = shown;
    line.append(cell);
  });
  return line;
}

/** Holds the first columns at the left edge, as many as leave half of the width to the others. */
function keepColumns(scroll, stay) {
  const table = scroll.querySelector("table");
  let left = 0;
  [...scroll.querySelectorAll("thead th")].slice(0, stay).forEach((head, column) => {
    const width = head.getBoundingClientRect().width;
    const kept = left + width <= scroll.clientWidth / 2;
    table.classList.toggle(`keeps-${column + 1}`, kept);
    table.style.setProperty(`--left-${column + 1}`, `${left}px`);
    left = kept ? left + width : Infinity;
  });
}

const groupsSorting = { column: -1, descending: false };

/** The rows whose names, as they are shown, contain every word of a search. */
function foundRows(columns, rows, search) {
  const words = search.toLowerCase().split(/\s+/).filter(Boolean);
  return rows.filter((row) => {
    const name = GROUP_COLUMNS.map((_, at) => cellText(columns[at], row, at))
      .join(" ")
      .toLowerCase();
    return words.every((word) => name.includes(word));
  });
}

/** The table of the groups that pass the filters and the search, of what one publishes or all columns; returns all. */
function showGroups({ most = MOST_ROWS } = {}) {
  const { times_ns: times, plain: values } = DATA.values;
  const shown = [...DATA.percentiles.filter((one) => one.is_decade).map(({ key }) => key), "max"];
  const rested = (key) => key !== "max" && Boolean(DATA.intervals.low_ns[view.metric]?.[key]);
  const bounded = (key) => ["p50", "p99"].includes(key) && Boolean(DATA.intervals.low_ns[view.metric]?.[key]);
  const columns = [
    ...GROUP_COLUMNS,
    { label: "Runs", format: formatCount },
    { label: "Planned", format: formatCount },
    { label: "Sent", format: formatCount },
    { label: "Unsent", format: formatCount },
    { label: "Received", unit: "ratio", format: formatRatio },
    ...shown.flatMap((key) => {
      const label = DATA.statistics.find((one) => one.key === key).label;
      return [
        { label: `${labelOf("metric")} ${label}`, unit: "ns", format: formatNs, stays: rested(key) },
        ...(bounded(key)
          ? [
              { label: `${label}, received, typical run`, unit: "ns", format: formatNs },
              { ...LOW, label: `${label} 95 % low` },
              { ...HIGH, label: `${label} 95 % high` },
            ]
          : []),
        ...(rested(key) ? [{ label: `${label} interval` }] : []),
      ];
    }),
    { label: "Transfer rate", unit: "bytes/s", format: formatBytesPerS },
    { label: "Achieved rate", unit: "Hz", format: formatHz },
    { label: "Duplicates", format: formatCount },
    { label: "Reordered", format: formatCount },
    { label: "Own nodes", unit: "ns", format: formatNs },
    { label: "Own share of the round trip", unit: "ratio", format: formatRatio },
  ];
  const rows = passingGroups().map((group) =>
    groupRow(
      group,
      values.runs[group],
      values.planned[group],
      values.published[group],
      values.unsent[group],
      values.received_ratio[group],
      ...shown.flatMap((key) => [
        times[view.metric][key][group],
        ...(bounded(key) ? [typicalOf(group, key), ...intervalOf(group, key)] : []),
        ...(rested(key) ? [restsOn(group, key)] : []),
      ]),
      values.transfer_rate_bytes_per_s[group],
      values.achieved_rate_hz[group],
      values.duplicates[group],
      values.reordered[group],
      values.own_cost_ns[group],
      values.own_share[group],
    ),
  );
  const found = foundRows(columns, rows, document.getElementById("groups-search").value);
  const isTypical = passingGroups().some((group) => typicalOf(group, "p50") !== null);
  const published = isTypical ? /^(Runs|Received)$|typical run|95 %/ : /^(Runs|Received)$|median$|p99$|95 %/;
  const every = document.getElementById("all-columns").checked;
  const shownOf = (column, at) => ({
    ...column,
    isLeft: !every && at >= GROUP_COLUMNS.length && !published.test(column.label),
  });
  showTable(document.getElementById("groups-table"), "All results that pass the filters", columns.map(shownOf), found, {
    sorting: groupsSorting,
    stay: GROUP_COLUMNS.length,
    most,
  });
  document.getElementById("groups-found").textContent =
    found.length === rows.length ? "" : `${formatCount(found.length)} of ${counted(rows.length, "result")}`;
  return { columns, rows: found };
}
