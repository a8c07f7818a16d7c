"use strict";
// What all kinds of figures share. A kind is a function of KINDS: (plan, width, all) -> what to draw and its table.
// {data, layout}   for plotly; no data where nothing passes the filters. A trace's `meta` is its line
//   legend           {dimension, options} of what is drawn, or parts [{name, color, tint}]
//   columns, rows    the table; a column is {label, unit?, format?}; numbers in rows are raw
//   missing          groups that pass but have no such value
//   foot             what a reader has to know besides
// Groups are spread over panels and lines by the rule and tables of reports/figures/figure.py (a test compares them).
const KINDS = {};

const { atoms: ATOMS, made_of: MADE_OF, most_lines: MOST_LINES } = DATA.facets;
const { titles: AXIS_TITLES, lost_much: LOST_MUCH } = DATA.facets;

const GROUP_COLUMNS = [
  { label: "Data" },
  { label: "Size", unit: "bytes", format: (_, row) => row.size },
  { label: "Rate", unit: "Hz", format: formatHz },
  { label: "Setup" },
];

function groupRow(group, ...values) {
  const cell = cellOf(group);
  const row = [cell.data, cell.bytes, cell.hz, seriesOf(group).label, ...values];
  Object.assign(row, { size: cell.size, group });
  return row;
}

function groupHover(group, ...lines) {
  const lost = isLossy(group) ? [`Only ${formatRatio(shareOf(group))} received`] : [];
  return [`<b>${plain(seriesOf(group).label)}</b>`, plain(cellOf(group).label), ...[...lost, ...lines].map(plain)].join(
    "<br>",
  );
}

function sampleHover(group) {
  const { received, published } = DATA.values.plain;
  return `${formatCount(received[group])} of ${counted(published[group], "message")} received`;
}

/** The share of a group's planned messages that came back; 1 where none was due. */
const shareOf = (group) => DATA.curves.shares[group] ?? 1;
/** The share received of a group that lost much, short enough to be next to its hollow mark; else empty. */
const lossText = (group) => DATA.curves.losses[group];
const isLossy = (group) => lossText(group) !== "";
const LOST_FOOT = `A hollow mark ${LOST_MUCH}; the number next to it is the share received.`;

const atomsOf = (key) => MADE_OF[key] || (key ? [key] : []);
const optionOf = (key, group) => DATA.dimensions[key].index[group];
const labelIn = (key, group) => DATA.dimensions[key].options[optionOf(key, group)].label;
const varies = (key) => DATA.dimensions[key].options.length > 1;

/** Look and labels of one line: an option of a dimension. */
function lookOf(dimension, option) {
  const own = DATA.dimensions[dimension].options[option];
  return { ...own, key: `${dimension}/${option}`, color: theme().dark ? own.dark : own.light };
}
const choiceLook = (group) => ({ ...lookOf("choice", optionOf("choice", group)), group });
const isHidden = (dimension, option) => view.hidden.has(`${dimension}/${option}`);

/** How a plan's groups are spread, under the reader's choice where the figure can follow it. */
function chosenFacet({ x, panels, lines }) {
  if (!lines) return { x, panels, lines };
  const along = atomsOf(x);
  const own = view.lines !== "auto" && !atomsOf(view.lines).some((atom) => along.includes(atom)) ? view.lines : lines;
  return { x, panels: view.panels === "auto" ? panels : view.panels, lines: own };
}

function positionOf(x, group) {
  const cell = cellOf(group);
  if (x === "size") return cell.bytes;
  const hz = cell.hz || DATA.values.plain.achieved_rate_hz[group] || 1;
  if (x === "rate") return hz;
  if (x === "load") return cell.bytes * hz;
  return x === "cell" || x === "plane" ? DATA.groups.cell[group] : optionOf(x, group);
}

const compareKeys = (a, b) =>
  a.findIndex((value, place) => value !== b[place]) < 0
    ? 0
    : a.reduce((sign, value, place) => sign || value - b[place], 0);

/** Atoms that set panels apart: in which order, and in a labelled grid across and down. */
function sidesOf({ x, panels, lines }) {
  const used = [...atomsOf(x), ...atomsOf(lines)];
  const beside = atomsOf(panels).filter((key) => !used.includes(key));
  if (beside.includes("size") && !used.includes("data")) beside.unshift("data");
  const below = ATOMS.filter((key) => !used.includes(key) && !beside.includes(key));
  // In a labelled grid columns are setups and what the panels were chosen by, else the last that varies.
  let across = [...beside, ...below.filter((atom) => MADE_OF.choice.includes(atom))];
  if (!across.some(varies)) across = below.filter(varies).slice(-1);
  return { beside, below, across, down: below.filter((atom) => !across.includes(atom)) };
}

const namesOf = (atoms, group) =>
  atoms
    .filter(varies)
    .map((atom) => labelIn(atom, group))
    .filter(Boolean)
    .join(", ");

/** Points {group, value} as panels {title, row, columns, lines: [{option, points: [{x, group, value}]}]}. */
function spread(facet, points) {
  const { x, lines } = facet;
  const { beside, below, across, down } = sidesOf(facet);
  const found = new Map();
  for (const point of points) {
    const key = [...below, ...beside].map((atom) => optionOf(atom, point.group));
    const name = key.join();
    if (!found.has(name)) found.set(name, { key, lines: new Map() });
    const option = lines ? optionOf(lines, point.group) : 0;
    const { lines: own } = found.get(name);
    if (!own.has(option)) own.set(option, []);
    own.get(option).push({ ...point, x: positionOf(x, point.group) });
  }
  return [...found.values()]
    .sort((a, b) => compareKeys(a.key, b.key))
    .flatMap(({ key, lines: own }) => {
      const made = [...own]
        .sort((a, b) => a[0] - b[0])
        .map(([option, its]) => ({ option, points: its.sort((a, b) => a.x - b.x || a.group - b.group) }));
      const first = made[0].points[0].group;
      const title = namesOf([...beside, ...below], first) || labelIn("data", first);
      const parts = Math.ceil(made.length / MOST_LINES),
        most = Math.ceil(made.length / parts);
      const numbered = (text, part) => (parts > 1 ? `${text} (${part + 1} of ${parts})` : text);
      return Array.from({ length: parts }, (_, part) => ({
        title: numbered(title, part),
        labels: { row: namesOf(down, first), column: numbered(namesOf(across, first), part) },
        row: key.slice(0, below.length).join(),
        column: key.slice(below.length).join(),
        lines: made.slice(part * most, (part + 1) * most),
      }));
    });
}

/** The groups of a plan that pass the filters and have a value, over panels, without lines that the reader hid. */
function collected(plan, valueOf, facet = chosenFacet(plan.facet)) {
  const found = { facet, panels: [], options: new Set(), points: [], missing: 0 };
  for (const group of plan.groups) {
    if (!passes(group)) continue;
    const value = valueOf(group);
    if (value === null || value === undefined) {
      found.missing += 1;
      continue;
    }
    found.points.push({ group, value });
  }
  for (const panel of spread(facet, found.points)) {
    for (const line of panel.lines) found.options.add(line.option);
    const lines = panel.lines.filter((line) => !facet.lines || !isHidden(facet.lines, line.option));
    if (lines.length) found.panels.push({ ...panel, lines, columns: 0 });
  }
  // Panels are in rows and columns of their own where none is missing.
  const columns = new Set(found.panels.map((panel) => panel.column)).size,
    rows = new Set(found.panels.map((panel) => panel.row)).size;
  found.columns = columns * rows === found.panels.length ? columns : 0;
  found.legend = facet.lines
    ? { dimension: facet.lines, options: [...found.options].sort((a, b) => a - b) }
    : { dimension: "choice", options: [] };
  return found;
}

/** One line of marks, each with its group; a mark is hollow where messages were lost. */
function marks(look, points, { x, y, hover, mode = "lines+markers", size = 7, symbol = look.symbol }) {
  const lossy = points.map((point) => point.group !== undefined && isLossy(point.group));
  return {
    type: "scatter",
    mode,
    name: plain(look.label),
    meta: look.key,
    x: points.map(x),
    y: points.map(y),
    customdata: points.map((point) => point.group ?? look.group),
    hovertext: points.map(hover),
    hoverinfo: "text",
    line: { color: look.color, dash: look.dash, width: 1.8 },
    marker: {
      color: look.color,
      symbol: lossy.some(Boolean) ? lossy.map((lost) => (lost ? `${symbol}-open` : symbol)) : symbol,
      size,
      line: { color: look.color, width: 1.4 },
    },
    cliponaxis: false,
  };
}

/** What is written next to the hollow marks of some traces: the shares received, where they are few enough to read. */
function sharesBeside(lines, traces) {
  const beside = lines.flatMap((line, place) =>
    line.points.flatMap((point, at) =>
      isLossy(point.group) && traces[place].y[at] !== null
        ? [
            {
              x: traces[place].x[at],
              y: traces[place].y[at],
              text: lossText(point.group),
              color: traces[place].line.color,
            },
          ]
        : [],
    ),
  );
  return beside.length <= 16 ? beside : [];
}

const pointsOf = (panel) => panel.lines.flatMap((line) => line.points);

/** Error bars of plotly for values of points with ends in the same unit; a missing end has no bar. */
function errorBars(points, valueOf, endsOf, factor, color) {
  const ends = points.map(endsOf);
  // A value may lie outside of its interval, which is of the typical run: nothing reaches from it to the nearer end.
  const reach = (value, end, way) =>
    value === null || end === null || end === undefined ? 0 : Math.max(0, way * (end - value)) / factor;
  if (ends.every((one) => !one || (one[0] === null && one[1] === null))) return undefined;
  return {
    type: "data",
    symmetric: false,
    color,
    thickness: 1.1,
    width: 3,
    array: points.map((point, place) => reach(valueOf(point), ends[place]?.[1], 1)),
    arrayminus: points.map((point, place) => reach(valueOf(point), ends[place]?.[0], -1)),
  };
}

const LOW = { label: "95 % low", unit: "ns", format: formatNs };
const HIGH = { label: "95 % high", unit: "ns", format: formatNs };

/** Whether the chosen statistic has intervals at all; means and extremes have none. */
const INTERVALS = (metric = view.metric) => Boolean(DATA.intervals.low_ns[metric]?.[view.statistic]);

function intervalHover(group) {
  const [low, high] = intervalOf(group);
  const ends = low === null && high === null ? "" : `95 %: ${formatNs(low)} to ${formatNs(high)}`;
  return [ends, restsOn(group)].filter(Boolean);
}

/** The columns of the interval of the chosen statistic, none where it has none, and a group's cells of them. */
const intervalColumns = () => (INTERVALS() ? [LOW, HIGH, { label: "Interval" }] : []);
const intervalCells = (group) => (INTERVALS() ? [...intervalOf(group), restsOn(group)] : []);

// Times are drawn in seconds, and each tick says its own unit: 500 µs, 2 ms, 1 s.
const S = 1e-9;

/** Ticks of an axis of times (in seconds), `most` of them at most, each with a unit of its own. */
function timeTicks([low, high], log, most = 6) {
  const wanted = log ? logTicks(10 ** low, 10 ** high, most) : linearTicks(low, high, most);
  return {
    tickmode: "array",
    tickangle: 0,
    tickvals: wanted,
    ticktext: wanted.map((value) => (value ? plain(formatNs(Math.round(value / S))) : "0")),
  };
}

function logTicks(low, high, most) {
  const decades = Array.from(
    { length: Math.ceil(Math.log10(high)) - Math.floor(Math.log10(low)) + 1 },
    (_, step) => 10 ** (Math.floor(Math.log10(low)) + step),
  );
  const within = (steps) =>
    decades.flatMap((power) => steps.map((step) => step * power)).filter((value) => value >= low && value <= high);
  const isApart = (ratio) => 2 * most * Math.log(ratio) >= Math.log(high / low);
  return (
    [[1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9], [1, 2, 3, 5, 7], [1, 2, 5], [1, 3], [1]]
      .map(within)
      .find((ticks) => ticks.length <= most && ticks.every((at, place) => !place || isApart(at / ticks[place - 1]))) ||
    within([1])
  );
}

function linearTicks(low, high, most) {
  const rough = (high - low) / (most - 1) || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough);
  return Array.from(
    { length: Math.floor(high / step) - Math.ceil(low / step) + 1 },
    (_, place) => (Math.ceil(low / step) + place) * step,
  );
}

/** The axis of times (values in ns) on the chosen scale. */
function timeAxis(values, ticks = 6) {
  const own = values.filter((value) => value !== null && value > 0);
  const least = S * own.reduce((a, b) => Math.min(a, b), Infinity),
    most = S * own.reduce((a, b) => Math.max(a, b), 0);
  const linear = [0, own.length ? 1.08 * most : 1];
  if (view.scale === "linear" || !own.length)
    return { type: "linear", range: linear, ...timeTicks(linear, false, ticks) };
  const range = logRange(least, most);
  return { type: "log", range, minor: { showgrid: false }, ...timeTicks(range, true, ticks) };
}

/** A range of a log axis around two values; one of nearly nothing is widened, so that no chance looks like a step. */
function logRange(least, most) {
  const [low, high] = [Math.log10(least), Math.log10(most)];
  const wide = Math.max(0, 0.5 - (high - low)) / 2 + 0.06 * (high - low) + 0.05;
  return [low - wide, high + wide];
}
const timeTitle = (label) => (view.scale === "log" ? `${label} (log scale)` : label);
const axisTitle = (text) => ({ text: plain(text), font: { size: 12, color: theme().soft }, standoff: 4 });
