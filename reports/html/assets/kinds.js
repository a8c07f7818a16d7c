"use strict";
// One function per kind of figure: (plan, width) -> what to draw and the same numbers as a table.
//   {data, layout}   for plotly; no data where nothing passes the filters
//   series           the places in DATA.series that are drawn, for the legend
//   columns, rows    the table; a column is {label, unit?, format?}; numbers in rows are raw
//   missing          groups that pass but have no such value

const GROUP_COLUMNS = [{ label: "Data" }, { label: "Size", unit: "bytes", format: (_, row) => row.size }, { label: "Rate", unit: "Hz", format: (value) => digits(value) }, { label: "Series" }];

function groupRow(group, ...values) {
  const cell = cellOf(group);
  const row = [cell.data, cell.bytes, cell.hz, seriesOf(group).label, ...values];
  Object.assign(row, { size: cell.size, group });
  return row;
}

function groupHover(group, ...lines) {
  return [`<b>${plain(seriesOf(group).label)}</b>`, plain(cellOf(group).label), ...lines.map(plain)].join("<br>");
}

function sampleHover(group) {
  const { received, published } = DATA.values.plain;
  return `${formatCount(received[group])} of ${counted(published[group], "message")} came back`;
}

/** The shares received of two groups, base first: `100 % -> 98.5 %`. */
function receivedWords(base, other) {
  return [base, other].map((group) => formatRatio(DATA.values.plain.received_ratio[group])).join(" -> ");
}

/** The points of a plan's lines that pass the filters and have a value. */
function collected(plan, valueOf) {
  const found = { panels: [], series: new Set(), groups: [], missing: 0 };
  for (const panel of plan.panels) {
    const lines = [];
    for (const line of panel.lines) {
      const points = [];
      line.groups.forEach((group, place) => {
        if (!passes(group)) return;
        const value = valueOf(group);
        if (value === null || value === undefined) { found.missing += 1; return; }
        points.push({ x: line.x[place], group, value });
        found.groups.push(group);
      });
      if (points.length) { lines.push({ series: line.series, points }); found.series.add(line.series); }
    }
    if (lines.length) found.panels.push({ title: panel.title, lines });
  }
  return found;
}

function marks(seriesPlace, points, { x, y, hover, mode = "lines+markers", size = 7, open = false }) {
  const series = DATA.series[seriesPlace];
  const color = seriesColor(series);
  return {
    type: "scatter", mode, name: plain(series.label), x: points.map(x), y: points.map(y), hovertext: points.map(hover), hoverinfo: "text",
    line: { color, dash: series.dash, width: 1.8 }, marker: { color, symbol: open && !series.symbol.includes("open") ? `${series.symbol}-open` : series.symbol, size, line: { color, width: 1.4 } }, cliponaxis: false,
  };
}

/** The trace with an error bar at each point whose group has an interval of the chosen statistic. */
function withInterval(trace, points, factor) {
  const bars = errorBars(points.map((point) => point.value), points.map((point) => intervalOf(point.group)), factor, trace.marker.color);
  return bars ? { ...trace, error_y: bars } : trace;
}

/** Whether the chosen statistic has intervals at all; means and extremes have none. */
const INTERVALS = () => Boolean(DATA.intervals.low_ns[view.metric]?.[view.statistic]);

function intervalHover(group) {
  const [low, high] = intervalOf(group);
  const ends = low === null && high === null ? "" : `95 %: ${formatNs(low)} to ${formatNs(high)}`;
  return [ends, restsOn(group)].filter(Boolean);
}

/** The columns of the interval of the chosen statistic, none where it has none, and a group's cells of them. */
const intervalColumns = () => (INTERVALS() ? [LOW, HIGH, { label: "Interval" }] : []);
const intervalCells = (group) => (INTERVALS() ? [...intervalOf(group), restsOn(group)] : []);

/** The axis of times in one unit, on the chosen scale. */
function timeAxis() {
  return view.scale === "log" ? { type: "log", minor: { showgrid: false }, dtick: null, nticks: 5, tickformat: "~g" } : { type: "linear", rangemode: "tozero", nticks: 6, tickformat: "~g" };
}

// From fast to slow; every shade is light enough for dark figures in it (WCAG AA), in both themes.
const HEAT = [[0, "#fff6d6"], [0.5, "#fbc66a"], [1, "#e8823a"]];

const KINDS = {
  lines(plan, width) {
    const found = collected(plan, statisticOf);
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const unit = axisUnit(points.map((point) => point.value));
    const labels = plan.x_unit === "bytes" ? (x, group) => cellOf(group).size : (x) => digits(x);
    const panels = found.panels.map((panel) => {
      const at = new Map(panel.lines.flatMap((line) => line.points.map((point) => [point.x, labels(point.x, point.group)])));
      const positions = [...at.keys()].sort((a, b) => a - b);
      return {
        title: panel.title, share: cellOf(panel.lines[0].points[0].group).data,
        traces: panel.lines.map((line) => withInterval(marks(line.series, line.points, {
          x: (point) => point.x, y: (point) => point.value / unit.factor,
          hover: (point) => groupHover(point.group, `${statisticLabel()}: ${formatNs(point.value)}`, ...intervalHover(point.group), sampleHover(point.group)),
        }), line.points, unit.factor)),
        x: tickedAxis(positions, positions.map((x) => at.get(x)), { room: plan.x_unit === "bytes" ? 46 : 26, title: plan.x_title }), y: timeAxis(),
      };
    });
    return {
      ...gridOf(panels, width, { yTitle: `${statisticLabel()} (${unit.label})`, below: 46 }),
      series: found.series, missing: found.missing,
      columns: [...GROUP_COLUMNS, { label: statisticLabel(), unit: "ns", format: formatNs }, ...intervalColumns()],
      rows: points.map((point) => groupRow(point.group, point.value, ...intervalCells(point.group))),
    };
  },

  cells(plan, width) {
    const percent = plan.value === "received_ratio";
    const own = plan.values_ns;  // times of the figure's own, in place of the chosen statistic
    const found = collected(plan, percent ? (group) => DATA.values.plain.received_ratio[group] : own ? (group) => own[group] : statisticOf);
    const intervals = !percent && !own && INTERVALS();
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const unit = percent ? { factor: 0.01, label: "%" } : axisUnit(points.map((point) => point.value));
    const label = percent ? "Received" : own ? plan.label : statisticLabel();
    const format = percent ? formatRatio : formatNs;
    const least = Math.min(1, ...points.map((point) => point.value)) * 100;
    const floor = least > 99 ? 99 : least > 90 ? 90 : least > 50 ? 50 : 0;
    const panels = found.panels.map((panel) => {
      const places = [...new Set(panel.lines.flatMap((line) => line.points.map((point) => point.x)))].sort((a, b) => a - b);
      const rank = new Map(places.map((place, index) => [place, index]));
      return {
        title: panel.title, weight: places.length, share: percent ? "" : DATA.cells[places[0]].data,
        traces: panel.lines.map((line) => {
          const trace = marks(line.series, line.points, {
            x: (point) => rank.get(point.x), y: (point) => point.value / unit.factor, mode: "markers", size: 8, open: percent,
            hover: (point) => groupHover(point.group, `${label}: ${format(point.value)}`, ...(percent || own ? [] : intervalHover(point.group)), sampleHover(point.group)),
          });
          return percent || own ? trace : withInterval(trace, line.points, unit.factor);
        }),
        ...cellAxis(places.map((place) => DATA.cells[place])),
        y: percent ? { type: "linear", range: [floor - (100 - floor) * 0.04, 100 + (100 - floor) * 0.06], nticks: 5 } : timeAxis(),
      };
    });
    const most = Math.max(1, ...panels.map((panel) => panel.weight));
    return {
      ...gridOf(panels, width, { yTitle: `${label} (${unit.label})`, minWidth: Math.min(width, Math.max(300, most * 17)), height: percent ? 150 : 230 }),
      series: found.series, missing: found.missing, foot: "Numbers below the axis: rate in Hz, and under it the size.",
      columns: [...GROUP_COLUMNS, { label, unit: percent ? "ratio" : "ns", format }, ...(intervals ? intervalColumns() : [])],
      rows: points.map((point) => groupRow(point.group, point.value, ...(intervals ? intervalCells(point.group) : []))),
    };
  },

  pairs(plan, width) {
    const found = { series: new Set(), missing: 0, rows: [] };
    const values = [];
    const kept = [];
    for (const panel of plan.panels) {
      const pairs = panel.pairs.filter((pair) => {
        if (!passes(pair.same) || !passes(pair.different)) return false;
        const has = statisticOf(pair.same) !== null && statisticOf(pair.different) !== null;
        if (!has) found.missing += 1;
        return has;
      });
      if (pairs.length) kept.push({ title: panel.title, pairs });
      for (const pair of pairs) {
        const [same, different] = [statisticOf(pair.same), statisticOf(pair.different)];
        values.push(same, different);
        found.rows.push(groupRow(pair.different, same, different, different - same, different / same, receivedWords(pair.same, pair.different)));
      }
    }
    const unit = axisUnit(values);
    // Wide enough to write what crossing cost along each bar, if the page is.
    const minWidth = Math.min(width - 80, Math.max(300, ...kept.map((panel) => {
      const bars = new Set(panel.pairs.flatMap((pair) => [DATA.groups.series[pair.same], DATA.groups.series[pair.different]])).size;
      return new Set(panel.pairs.map((pair) => pair.rate_hz)).size * bars * 13.5;
    })));
    const panels = kept.map((panel) => {
      const rates = [...new Set(panel.pairs.map((pair) => pair.rate_hz))].sort((a, b) => a - b);
      const bars = new Map();   // series -> rate -> {group, added}
      for (const pair of panel.pairs) {
        const added = statisticOf(pair.different) - statisticOf(pair.same);
        for (const [group, difference] of [[pair.same, null], [pair.different, added]]) {
          const series = DATA.groups.series[group];
          found.series.add(series);
          if (!bars.has(series)) bars.set(series, new Map());
          bars.get(series).set(pair.rate_hz, { group, difference });
        }
      }
      const order = [...bars.keys()].sort((a, b) => a - b);
      // The bars stand at least this many px apart; what crossing cost is written along a bar that is too thin.
      const room = (0.75 * minWidth) / (rates.length * order.length);
      const most = Math.max(...panel.pairs.flatMap((pair) => [statisticOf(pair.same), statisticOf(pair.different)])) / unit.factor;
      return {
        title: panel.title,
        traces: order.map((place) => {
          const series = DATA.series[place];
          const color = seriesColor(series);
          const entries = [...bars.get(place).entries()];
          return {
            type: "bar", name: plain(series.label), x: entries.map(([rate]) => rates.indexOf(rate)),
            y: entries.map(([, bar]) => statisticOf(bar.group) / unit.factor),
            text: room > 10 ? entries.map(([, bar]) => (bar.difference === null ? "" : signed(bar.difference, formatNs))) : undefined,
            textposition: "outside", textfont: { size: room > 12 ? 10 : 9, color: theme().ink }, textangle: room > 44 ? 0 : -90, cliponaxis: false, constraintext: "none",
            hoverinfo: "text", hovertext: entries.map(([, bar]) => groupHover(bar.group, `${statisticLabel()}: ${formatNs(statisticOf(bar.group))}`, ...(bar.difference === null ? [] : [`${signed(bar.difference, formatNs)} against the same domain`]), sampleHover(bar.group))),
            marker: { color, line: { color, width: 1 }, pattern: series.different ? { shape: "/", fgcolor: color, bgcolor: theme().ground, size: 6, solidity: 0.45 } : {} },
          };
        }),
        x: (panelWidth) => ({ ...tickedAxis(rates.map((_, place) => place), rates.map(digits), { log: false, room: 22, title: "Rate (Hz)" })(panelWidth), range: [-0.55, rates.length - 0.45], showgrid: false }),
        y: { type: "linear", range: [0, most * (room > 44 || room <= 10 ? 1.12 : 1.3)], nticks: 5 },
      };
    });
    const drawn = gridOf(panels, width, { yTitle: `${statisticLabel()} (${unit.label})`, minWidth, below: 46 });
    Object.assign(drawn.layout, { barmode: "group", bargap: 0.25, bargroupgap: 0.05 });
    return {
      ...drawn, series: found.series, missing: found.missing,
      columns: [...GROUP_COLUMNS, { label: "Same domain", unit: "ns", format: formatNs }, { label: "Different domains", unit: "ns", format: formatNs }, { label: "Difference", unit: "ns", format: (value) => signed(value, formatNs) }, { label: "Ratio", unit: "ratio", format: digits }, { label: "Received" }],
      rows: found.rows,
    };
  },

  load(plan, width) {
    const found = collected(plan, (group) => DATA.values.plain.transfer_rate_bytes_per_s[group]);
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const panels = found.panels.map((panel) => {
      const all = panel.lines.flatMap((line) => line.points);
      const ends = [Math.min(...all.map((point) => point.x)), Math.max(...all.map((point) => point.x))];
      const diagonal = { type: "scatter", mode: "lines", x: ends, y: ends, hoverinfo: "skip", line: { color: theme().soft, dash: "dash", width: 1 } };
      return {
        title: panel.title,
        traces: [diagonal, ...panel.lines.map((line) => marks(line.series, line.points, {
          x: (point) => point.x, y: (point) => point.value, mode: "markers", size: 9, open: true,
          hover: (point) => groupHover(point.group, `Offered: ${formatBytesPerS(point.x)}`, `Transfer rate: ${formatBytesPerS(point.value)}`, sampleHover(point.group)),
        }))],
        x: () => loadAxis(ends, "Offered load"), y: loadAxis(all.map((point) => point.value)),
      };
    });
    return {
      ...gridOf(panels, width, { yTitle: "Transfer rate", height: 240, below: 46 }), series: found.series, missing: found.missing,
      columns: [...GROUP_COLUMNS, { label: "Offered", unit: "bytes/s", format: formatBytesPerS }, { label: "Transfer rate", unit: "bytes/s", format: formatBytesPerS }],
      rows: points.map((point) => groupRow(point.group, point.x, point.value)),
    };
  },

  heatmap(plan, width) {
    const plainColumn = DATA.values.plain[view.tiles];
    const valueOf = plainColumn ? (group) => plainColumn[group] : statisticOf;
    const { label, unit, format } = {
      statistic: { label: statisticLabel(), unit: "ns", format: formatNs },
      received_ratio: { label: "Received", unit: "ratio", format: formatRatio },
      transfer_rate_bytes_per_s: { label: "Transfer rate", unit: "bytes/s", format: formatBytesPerS },
    }[view.tiles];
    const log = view.tiles !== "received_ratio";
    const shade = (value) => (log ? Math.log10(Math.max(value, 1)) : value);
    let missing = 0;
    const kept = plan.panels.map((panel) => ({
      title: panel.title,
      tiles: panel.tiles.filter(([, , group]) => passes(group)).filter(([, , group]) => {
        const has = valueOf(group) !== null;
        if (!has) missing += 1;
        return has;
      }),
    })).filter((panel) => panel.tiles.length);
    const values = kept.flatMap((panel) => panel.tiles.map(([, , group]) => valueOf(group)));
    const least = Math.min(...values), most = Math.max(...values);
    const span = { low: log ? shade(least) : Math.min(least, 0.99), high: log ? shade(most) : 1 };
    const minWidth = Math.max(300, ...kept.map((panel) => new Set(panel.tiles.map(([, rate]) => rate)).size * 40));
    const steps = Array.from({ length: 5 }, (_, step) => span.low + ((span.high - span.low) * step) / 4);
    const panels = kept.map((panel, place) => {
      const sizes = new Map(panel.tiles.map(([bytes, , group]) => [bytes, cellOf(group).size]).sort((a, b) => a[0] - b[0]));
      const rates = [...new Set(panel.tiles.map(([, rate]) => rate))].sort((a, b) => a - b);
      const rows = [...sizes.keys()];
      const grid = (of) => rows.map((bytes) => rates.map((rate) => {
        const tile = panel.tiles.find(([b, r]) => b === bytes && r === rate);
        return tile ? of(tile[2]) : null;
      }));
      return {
        title: panel.title, height: Math.max(34, 26 * rows.length),
        traces: [{
          type: "heatmap", z: grid((group) => shade(valueOf(group))), text: grid((group) => format(valueOf(group)).replace(" ", "\u00a0")),
          hovertext: grid((group) => groupHover(group, `${label}: ${format(valueOf(group))}`, sampleHover(group))), hoverinfo: "text",
          texttemplate: minWidth / rates.length >= 38 ? "%{text}" : undefined, textfont: { size: 10, color: "#1b1f24" }, xgap: 2, ygap: 2,
          colorscale: HEAT, reversescale: view.tiles !== "statistic", zmin: span.low, zmax: span.high === span.low ? span.low + 1 : span.high, showscale: place === 0,
          colorbar: { thickness: 12, lenmode: "pixels", len: 150, y: 1, yanchor: "top", outlinewidth: 0, tickmode: "array", tickvals: steps, ticktext: steps.map((step) => plain(format(log ? 10 ** step : step))), tickfont: { size: 11, color: theme().soft } },
        }],
        x: () => ({ type: "linear", tickmode: "array", tickvals: rates.map((_, i) => i), ticktext: rates.map((rate) => digits(rate)), showgrid: false, zeroline: false, title: { text: "Rate (Hz)", font: { size: 11, color: theme().soft }, standoff: 4 } }),
        y: { type: "linear", tickmode: "array", tickvals: rows.map((_, i) => i), ticktext: rows.map((bytes) => plain(sizes.get(bytes))), showgrid: false, zeroline: false },
      };
    });
    return {
      ...gridOf(panels, width, { minWidth: Math.min(minWidth, width - 80), right: 84, below: 46 }), series: new Set(), missing,
      foot: `Tiles show: ${label}.`,
      columns: [...GROUP_COLUMNS, { label, unit, format }],
      rows: kept.flatMap((panel) => panel.tiles.map(([, , group]) => groupRow(group, valueOf(group)))),
    };
  },

  percentile_curve(_, width) { return distribution(width, true); },
  ecdf(_, width) { return distribution(width, false); },

  timeline(plan, width) {
    const cell = shownCell();
    const groups = passingGroups().filter((group) => DATA.groups.cell[group] === cell && plan.groups[group]);
    const metric = view.metric === "latency" ? "latency_ns" : "rtt_ns";
    const label = metric === "latency_ns" ? "Latency" : "Round trip";
    const values = groups.flatMap((group) => plan.groups[group][metric].filter((value) => value !== null));
    const unit = axisUnit(values);
    const lossy = groups.filter((group) => plan.groups[group].lost_elapsed_s.length);
    const dots = groups.map((group) => {
      const points = plan.groups[group].elapsed_s.map((at, place) => ({ at, value: plan.groups[group][metric][place] })).filter((point) => point.value !== null);
      const trace = marks(DATA.groups.series[group], points, {
        x: (point) => point.at, y: (point) => point.value / unit.factor, mode: "markers", size: 4.5,
        hover: (point) => groupHover(group, `at ${digits(point.at)} s`, `${label}: ${formatNs(point.value)}`),
      });
      trace.marker.opacity = 0.75;
      return trace;
    });
    const crosses = lossy.map((group, place) => {
      const { lost_elapsed_s: at, lost_count: count } = plan.groups[group];
      const trace = marks(DATA.groups.series[group], at.map((second, index) => ({ second, count: count[index] })), {
        x: (point) => point.second, y: () => lossy.length - place, mode: "markers", size: 8,
        hover: (point) => groupHover(group, `${formatCount(point.count)} lost at ${digits(point.second)} s`),
      });
      trace.marker = { ...trace.marker, symbol: "x-thin-open" };
      trace.yaxis = "y2";
      return trace;
    });
    const panel = { title: cell === null ? "" : DATA.cells[cell].label, traces: dots, x: () => ({ type: "linear", title: { text: "Time since the run's first message (s)", font: { size: 11, color: theme().soft }, standoff: 4 }, zeroline: false }), y: timeAxis() };
    const drawn = gridOf(values.length || lossy.length ? [panel] : [], width, { yTitle: `${label} (${unit.label})`, height: 260, below: 46 });
    if (drawn.layout.yaxis) {
      for (const group of groups) {
        for (const [start, end] of plan.outages[group] || []) {
          drawn.layout.shapes.push({ type: "rect", xref: "x", yref: "y domain", x0: start, x1: end, y0: 0, y1: 1, layer: "below", fillcolor: seriesColor(seriesOf(group)), opacity: 0.16, line: { width: 0 } });
        }
      }
    }
    if (lossy.length && drawn.layout.yaxis) {
      const [bottom, top] = drawn.layout.yaxis.domain;
      const strip = top - Math.min(0.3, 0.06 + 0.045 * lossy.length) * (top - bottom);
      drawn.layout.yaxis.domain = [bottom, strip];
      drawn.layout.yaxis2 = { ...axisStyle(theme()), domain: [strip + 0.02, top], anchor: "x", range: [0.3, lossy.length + 0.7], tickmode: "array", tickvals: [(lossy.length + 1) / 2], ticktext: ["lost"], showgrid: false, zeroline: false, fixedrange: true };
      drawn.data.push(...crosses);
    }
    return {
      ...drawn, series: new Set(groups.map((group) => DATA.groups.series[group])), missing: 0,
      foot: plan.decimated ? "Thinned for drawing: of each slice of time the fastest and the slowest message are kept, and every loss is counted." : "",
      columns: [...GROUP_COLUMNS, { label: "Time", unit: "s", format: digits }, { label, unit: "ns", format: formatNs }, { label: "Lost", unit: "messages", format: formatCount }],
      rows: groups.flatMap((group) => [
        ...plan.groups[group].elapsed_s.map((at, place) => groupRow(group, at, plan.groups[group][metric][place], 0)),
        ...plan.groups[group].lost_elapsed_s.map((at, place) => groupRow(group, at, null, plan.groups[group].lost_count[place])),
      ]),
    };
  },
};

/** The named percentiles of a group's curve with their intervals, where the sample supports them. */
function percentileMarks(group, factor) {
  const times = DATA.values.times_ns[view.metric];
  const named = [["p50", 2], ["p90", 10], ["p95", 20], ["p99", 100], ["p99_9", 1000]].map(([name, at]) => ({ name, at, value: times[name][group], ends: intervalOf(group, name) }))
    .filter((one) => one.value !== null && one.ends.some((end) => end !== null));
  if (!named.length) return [];
  const trace = marks(DATA.groups.series[group], named, {
    x: (one) => one.at, y: (one) => one.value / factor, mode: "markers", size: 6,
    hover: (one) => groupHover(group, `${one.name.replace("_", ".")}: ${formatNs(one.value)}`, `95 %: ${formatNs(one.ends[0])} to ${formatNs(one.ends[1])}`, restsOn(group, one.name)),
  });
  trace.error_y = errorBars(named.map((one) => one.value), named.map((one) => one.ends), factor, trace.marker.color);
  return [trace];
}

/** Both figures of a distribution: the tail of the survivors by rarity, or the share of the messages planned in time. */
function distribution(width, byRarity) {
  const cell = shownCell();
  const { values_ns: { [view.metric]: curves }, levels, shares } = DATA.curves;
  const inCell = passingGroups().filter((group) => DATA.groups.cell[group] === cell);
  const groups = inCell.filter((group) => curves[group].length > 1);
  const unit = axisUnit(groups.flatMap((group) => curves[group]));
  // A curve by share ends at the slowest message that came back, at the share that came back.
  const last = (group) => Math.max(curves[group][curves[group].length - 1], DATA.values.times_ns[view.metric].max[group] ?? 0);
  const pointsOf = (group) => [...curves[group].map((value, place) => ({ value, level: levels[place] })), ...(byRarity ? [] : [{ value: last(group), level: 1 }])];
  const title = (text) => ({ text: plain(text), font: { size: 11, color: theme().soft }, standoff: 4 });
  const valueTitle = `${labelOf("metric")} (${unit.label})`;
  const cellTitle = cell === null ? "" : DATA.cells[cell].label;
  const lines = (x, y, said) => groups.map((group) => {
    const trace = marks(DATA.groups.series[group], pointsOf(group), {
      x: (point) => x(point, group), y: (point) => y(point, group), mode: "lines",
      hover: (point) => groupHover(group, said(point, group), sampleHover(group)),
    });
    trace.line.width = 2.2;
    return trace;
  });
  const common = { series: new Set(groups.map((group) => DATA.groups.series[group])), missing: inCell.length - groups.length };
  if (byRarity) {
    const rarities = [[2, "p50"], [10, "p90"], [100, "p99"], [1000, "p99.9"], [10000, "p99.99"]];
    const deepest = Math.max(...groups.map((group) => 1 / (1 - levels[curves[group].length - 1])));
    const panel = {
      title: cellTitle, y: timeAxis(),
      traces: lines((point) => 1 / (1 - point.level), (point) => point.value / unit.factor, (point) => `p${digits(100 * point.level)}: ${formatNs(point.value)}`).concat(groups.flatMap((group) => percentileMarks(group, unit.factor))),
      x: () => ({ type: "log", range: [0, Math.log10(Math.max(deepest, 10)) + 0.05], tickmode: "array", tickvals: rarities.map(([x]) => x), ticktext: rarities.map(([, name]) => name), title: title("Percentile of the survivors") }),
    };
    return {
      ...gridOf(groups.length ? [panel] : [], width, { yTitle: valueTitle, height: 300, below: 46 }), ...common,
      columns: [...GROUP_COLUMNS, { label: "Percentile", unit: "%", format: digits }, { label: labelOf("metric"), unit: "ns", format: formatNs }],
      rows: groups.flatMap((group) => pointsOf(group).map(({ value, level }) => groupRow(group, Math.round(level * 1e8) / 1e6, value))),
    };
  }
  const byShare = (of, shareOf) => ({
    title: `${of}, ${cellTitle}`, share: "share", y: { type: "linear", range: [-2, 102], nticks: 6 },
    traces: lines((point) => point.value / unit.factor, (point, group) => 100 * point.level * shareOf(group), (point, group) => `${formatRatio(point.level * shareOf(group))} of the ${of.toLowerCase()} within ${formatNs(point.value)}`),
    x: () => ({ ...timeAxis(), rangemode: "normal", title: title(valueTitle) }),
  });
  const panels = [byShare("Messages planned", (group) => shares[group])];
  if (groups.some((group) => shares[group] < 1)) panels.push(byShare("Survivors", () => 1));
  const percent = (value) => Math.round(value * 1e8) / 1e6;
  return {
    ...gridOf(groups.length ? panels : [], width, { yTitle: "Messages (%)", minWidth: 240, height: 300, below: 46 }), ...common,
    columns: [...GROUP_COLUMNS, { label: "Share of planned", unit: "%", format: digits }, { label: "Share of survivors", unit: "%", format: digits }, { label: labelOf("metric"), unit: "ns", format: formatNs }],
    rows: groups.flatMap((group) => pointsOf(group).map(({ value, level }) => groupRow(group, percent(level * shares[group]), percent(level), value))),
  };
}
