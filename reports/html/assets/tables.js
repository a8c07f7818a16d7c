"use strict";
// Tables whose columns sort. A column is {label, unit?, format?}; a number is shown by `format`, sorted as it is.
const MOST_ROWS = 2000;

function compareCells(a, b) {
  const missing = (value) => value === null || value === undefined;
  if (missing(a) || missing(b)) return missing(a) - missing(b);
  return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
}

function isNumeric(rows, column) { return rows.some((row) => typeof row[column] === "number"); }

/** Puts the table into `place`; `sorting` {column, descending} survives when filters change the rows. */
function showTable(place, caption, columns, rows, sorting = { column: -1, descending: false }) {
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
  columns.forEach((column, place_) => {
    const button = element("button", { type: "button" }, column.label);
    const cell = element("th", { scope: "col" }, button);
    if (isNumeric(rows, place_)) cell.className = "number";
    if (sorting.column === place_) cell.setAttribute("aria-sort", sorting.descending ? "descending" : "ascending");
    button.addEventListener("click", () => {
      const again = sorting.column === place_;
      Object.assign(sorting, { column: place_, descending: again && !sorting.descending });
      showTable(place, caption, columns, rows, sorting);
      place.querySelectorAll("thead button")[place_].focus();
    });
    head.append(cell);
  });
  const numeric = columns.map((_, column) => isNumeric(rows, column));
  const body = element("tbody");
  for (const row of sorted.slice(0, MOST_ROWS)) {
    const line = element("tr");
    columns.forEach((column, at) => {
      const value = row[at];
      const shown = value === null || value === undefined ? MISSING : typeof value === "number" && column.format ? column.format(value, row) : String(value);
      const cell = element("td", numeric[at] ? { class: "number" } : {}, shown);
      if (shown.length > 40) cell.title = shown;
      line.append(cell);
    });
    body.append(line);
  }
  const table = element("table", { class: "data" }, element("caption", { class: "unseen" }, caption), element("thead", {}, head), body);
  const scroll = element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption }, table);
  const left = rows.length - MOST_ROWS;
  place.replaceChildren(scroll, ...(left > 0 ? [element("p", { class: "note" }, `${formatCount(left)} more rows are in the CSV file.`)] : []));
}

const groupsSorting = { column: -1, descending: false };

function showGroups() {
  const { times_ns: times, plain: values } = DATA.values;
  const shown = ["p50", "p90", "p99", "p99_9", "max"].filter((key) => DATA.statistics.some((one) => one.key === key));
  const rested = (key) => key !== "max" && Boolean(DATA.intervals.low_ns[view.metric]?.[key]);
  const bounded = (key) => ["p50", "p99"].includes(key) && Boolean(DATA.intervals.low_ns[view.metric]?.[key]);
  const columns = [
    ...GROUP_COLUMNS,
    { label: "Runs", format: formatCount }, { label: "Planned", format: formatCount }, { label: "Sent", format: formatCount }, { label: "Unsent", format: formatCount }, { label: "Received", unit: "ratio", format: formatRatio },
    ...shown.flatMap((key) => {
      const label = DATA.statistics.find((one) => one.key === key).label;
      return [{ label: `${labelOf("metric")} ${label}`, unit: "ns", format: formatNs }, ...(bounded(key) ? [{ ...LOW, label: `${label} 95 % low` }, { ...HIGH, label: `${label} 95 % high` }] : []), ...(rested(key) ? [{ label: `${label} interval` }] : [])];
    }),
    { label: "Transfer rate", unit: "bytes/s", format: formatBytesPerS }, { label: "Achieved rate", unit: "Hz", format: formatHz },
    { label: "Duplicates", format: formatCount }, { label: "Reordered", format: formatCount },
    { label: "Own nodes", unit: "ns", format: formatNs }, { label: "Own share of the round trip", unit: "ratio", format: formatRatio },
  ];
  const rows = passingGroups().map((group) => groupRow(
    group, values.runs[group], values.planned[group], values.published[group], values.unsent[group], values.received_ratio[group],
    ...shown.flatMap((key) => [times[view.metric][key][group], ...(bounded(key) ? intervalOf(group, key) : []), ...(rested(key) ? [restsOn(group, key)] : [])]),
    values.transfer_rate_bytes_per_s[group], values.achieved_rate_hz[group], values.duplicates[group], values.reordered[group],
    values.own_cost_ns?.[group] ?? null, values.own_share?.[group] ?? null,
  ));
  showTable(document.getElementById("groups-table"), "All groups that pass the filters", columns, rows, groupsSorting);
  return { columns, rows };
}
