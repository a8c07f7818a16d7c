"use strict";
// Kinds of figures that rest on the details of an analysis: parts of the time, one way, bridges, clocks, hosts. As in kinds.js.

/** Error bars of plotly for values with ends in the same unit; a missing end has no bar. */
function errorBars(values, ends, factor, color) {
  // A value may lie outside of its interval, which is of the typical run: then nothing reaches from it to the nearer end.
  const reach = (value, end, way) => (value === null || end === null || end === undefined ? 0 : Math.max(0, way * (end - value)) / factor);
  if (ends.every((one) => !one || (one[0] === null && one[1] === null))) return undefined;
  return {
    type: "data", symmetric: false, color, thickness: 1.1, width: 3,
    array: values.map((value, place) => reach(value, ends[place] && ends[place][1], 1)), arrayminus: values.map((value, place) => reach(value, ends[place] && ends[place][0], -1)),
  };
}

const LOW = { label: "95 % low", unit: "ns", format: formatNs };
const HIGH = { label: "95 % high", unit: "ns", format: formatNs };

function axisTitle(text) { return { text: plain(text), font: { size: 11, color: theme().soft }, standoff: 4 }; }

// Colour and filling of each part: one hue a way, deliveries hatched.
const PART_LOOKS = {
  waiting_ns: [0], outbound_ns: [1], outbound_transport_ns: [1], relay_delivery_ns: [1, "/"], relay_ns: [2], return_ns: [3], return_transport_ns: [3], ping_delivery_ns: [3, "/"],
};

Object.assign(KINDS, {
  breakdown(plan, width) {
    const colors = theme();
    const partOf = (group, name) => plan.parts[group].find((part) => part.name === name) || null;
    const total = (group) => plan.parts[group].reduce((sum, part) => sum + part.mean_ns, 0);
    const found = collected(plan, total);
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const unit = axisUnit(points.map((point) => point.value));
    const hover = (group) => groupHover(group, ...plan.parts[group].map((part) => `${plan.names[part.name]}: ${formatNs(part.mean_ns)}${part.bound_ns ? ` ± ${formatNs(part.bound_ns)}` : ""}`));
    const used = plan.order.filter((name) => points.some((point) => partOf(point.group, name)));
    const panels = found.panels.map((panel) => {
      const shown = panel.lines.flatMap((line) => line.points);
      return {
        title: panel.title, weight: shown.length,
        traces: used.map((name) => {
          const color = colors.parts[PART_LOOKS[name][0]];
          return {
            type: "bar", name: plan.names[name], x: shown.map((_, place) => place), y: shown.map((point) => { const part = partOf(point.group, name); return part ? part.mean_ns / unit.factor : null; }),
            marker: { color, line: { color, width: PART_LOOKS[name][1] ? 1 : 0 }, pattern: PART_LOOKS[name][1] ? { shape: PART_LOOKS[name][1], fgcolor: color, bgcolor: colors.ground, size: 5, solidity: 0.4 } : {} },
            hoverinfo: "text", hovertext: shown.map((point) => hover(point.group)),
          };
        }),
        ...cellAxis(shown.map((point) => DATA.cells[point.x])),
        y: { type: "linear", rangemode: "tozero", nticks: 5 },
      };
    });
    const most = Math.max(1, ...panels.map((panel) => panel.weight));
    const drawn = gridOf(panels, width, { yTitle: `Mean (${unit.label})`, minWidth: Math.min(width, Math.max(300, most * 15)), height: 190 });
    Object.assign(drawn.layout, { barmode: "relative", bargap: 0.2 });
    const bounds = points.flatMap((point) => plan.parts[point.group].map((part) => part.bound_ns || 0));
    const bounded = Math.max(0, ...bounds);
    return {
      ...drawn, series: new Set(), parts: used.map((name) => ({ name: plan.names[name], color: colors.parts[PART_LOOKS[name][0]], hatched: Boolean(PART_LOOKS[name][1]) })), missing: found.missing,
      foot: `Numbers below the axis: rate in Hz, and under it the size.${bounded ? ` Clocks of two devices, or wall and monotonic clock of one, divide there from back and transport from delivery to ${formatNs(bounded)} at worst (mean of a group).` : ""}`,
      columns: [...GROUP_COLUMNS, ...used.flatMap((name) => [{ label: plan.names[name], unit: "ns", format: formatNs }, { label: "±", unit: "ns", format: formatNs }])],
      rows: points.map((point) => groupRow(point.group, ...used.flatMap((name) => { const part = partOf(point.group, name); return part ? [part.mean_ns, part.bound_ns] : [null, null]; }))),
    };
  },

  one_way(plan, width) {
    const valueOf = (group) => { const way = plan.ways[group]; const [out, back] = [way.outbound_ns[view.statistic], way.return_ns[view.statistic]]; return out === null || back === null ? null : [out, back]; };
    const found = collected(plan, valueOf);
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const unit = axisUnit(points.flatMap((point) => point.value));
    const statistic = labelOf("statistic");
    const panels = found.panels.map((panel) => {
      const shown = panel.lines.flatMap((line) => line.points.map((point) => ({ ...point, series: line.series })));
      const color = seriesColor(DATA.series[shown[0].series]);
      const traces = [0, 1].map((way) => {
        const trace = marks(shown[0].series, shown, {
          x: (point) => shown.indexOf(point) + (way - 0.5) * 0.24, y: (point) => point.value[way] / unit.factor, mode: "markers", size: 8,
          hover: (point) => groupHover(point.group, `Way out, ${statistic}: ${formatNs(point.value[0])}`, `Way back, ${statistic}: ${formatNs(point.value[1])}`, `Clocks: ± ${formatNs(plan.ways[point.group].bound_ns)}`),
        });
        trace.marker = { ...trace.marker, symbol: way ? "triangle-left-open" : "triangle-right" };
        const bounds = shown.map((point) => (plan.ways[point.group].bound_ns || 0) / unit.factor);
        if (bounds.some((bound) => bound > 0)) trace.error_y = { type: "data", array: bounds, color, thickness: 1.1, width: 3 };
        return trace;
      });
      return { title: panel.title, weight: shown.length, share: DATA.cells[shown[0].x].data, traces, ...cellAxis(shown.map((point) => DATA.cells[point.x])), y: timeAxis() };
    });
    const most = Math.max(1, ...panels.map((panel) => panel.weight));
    return {
      ...gridOf(panels, width, { yTitle: `One way, ${statistic} (${unit.label})`, minWidth: Math.min(width, Math.max(300, most * 20)), height: 190 }),
      series: found.series, missing: found.missing, foot: "Numbers below the axis: rate in Hz, and under it the size. Where no bar is drawn, ping and relay shared one clock.",
      columns: [...GROUP_COLUMNS, { label: `Way out, ${statistic}`, unit: "ns", format: formatNs }, { label: `Way back, ${statistic}`, unit: "ns", format: formatNs }, { label: "Clock bound", unit: "ns", format: formatNs }],
      rows: points.map((point) => groupRow(point.group, ...point.value, plan.ways[point.group].bound_ns)),
    };
  },

  bridge_cost(plan, width) {
    const instead = { mean: "p50", min: "p50", max: "p99" }[view.statistic];  // only percentiles are compared
    const statistic = instead || view.statistic;
    const label = DATA.statistics.find((choice) => choice.key === statistic).label;
    let missing = 0;
    const kept = plan.panels.map((panel) => ({
      title: panel.title,
      cells: panel.cells.filter((cell) => passes(cell.group)).filter((cell) => {
        if (!cell.costs[statistic]) missing += 1;
        return Boolean(cell.costs[statistic]);
      }),
    })).filter((panel) => panel.cells.length);
    const all = kept.flatMap((panel) => panel.cells);
    const series = new Set(all.map((cell) => DATA.groups.series[cell.group]));
    const unit = axisUnit(all.flatMap((cell) => [cell.costs[statistic].difference_ns, cell.costs[statistic].high_ns || 0]));
    const cpu = (cell) => (cell.bridge_cpu_percent === null ? "" : `Bridge: ${digits(cell.bridge_cpu_percent)} % of a processor`);
    const panels = kept.map((panel) => {
      const places = [...new Set(panel.cells.map((cell) => DATA.groups.cell[cell.group]))].sort((a, b) => a - b);
      const lines = [...new Set(panel.cells.map((cell) => DATA.groups.series[cell.group]))];
      return {
        title: panel.title, weight: places.length * Math.max(1, lines.length / 2),
        traces: lines.map((line, place) => {
          const cells = panel.cells.filter((cell) => DATA.groups.series[cell.group] === line);
          const trace = marks(line, cells, {
            x: (cell) => places.indexOf(DATA.groups.cell[cell.group]) + (lines.length > 1 ? 0.4 * (place / (lines.length - 1) - 0.5) : 0),
            y: (cell) => cell.costs[statistic].difference_ns / unit.factor, mode: "markers", size: 8,
            hover: (cell) => { const cost = cell.costs[statistic]; return groupHover(cell.group, `${label}: ${signed(cost.difference_ns, formatNs)} (95 %: ${formatNs(cost.low_ns)} to ${formatNs(cost.high_ns)})`, `Runs: ${cost.runs}`, `Received: ${cost.received}`, ...[cpu(cell)].filter(Boolean)); },
          });
          trace.error_y = errorBars(cells.map((cell) => cell.costs[statistic].difference_ns), cells.map((cell) => [cell.costs[statistic].low_ns, cell.costs[statistic].high_ns]), unit.factor, trace.marker.color);
          return trace;
        }),
        ...cellAxis(places.map((place) => DATA.cells[place])),
        y: { type: "linear", rangemode: "tozero", nticks: 6, zeroline: true, zerolinewidth: 2, zerolinecolor: theme().soft },
      };
    });
    const most = Math.max(1, ...panels.map((panel) => panel.weight));
    return {
      ...gridOf(panels, width, { yTitle: `Added latency, ${label} (${unit.label})`, minWidth: Math.min(width, Math.max(300, most * 18)) }),
      series, missing, foot: `${instead ? `Compared: the ${label} of the latency, as only percentiles are. ` : ""}Numbers below the axis: rate in Hz, and under it the size.`,
      columns: [...GROUP_COLUMNS, { label: `Added, ${label}`, unit: "ns", format: (value) => signed(value, formatNs) }, LOW, HIGH, { label: "Runs" }, { label: "Received" }, { label: "Ratio", unit: "ratio", format: digits }, { label: "Verdict" }, { label: "Bridge CPU", unit: "% of a processor", format: digits }],
      rows: all.map((cell) => { const cost = cell.costs[statistic]; return groupRow(cell.group, cost.difference_ns, cost.low_ns, cost.high_ns, cost.runs, cost.received, cost.ratio, { worse: "slower", better: "faster" }[cost.verdict] || cost.verdict, cell.bridge_cpu_percent); }),
    };
  },

  sustainable(plan, width) {
    const { achieved_rate_hz: achieved, received_ratio: received } = DATA.values.plain;
    const found = collected(plan, (group) => (100 * achieved[group] * received[group]) / cellOf(group).hz);
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const least = Math.min(100, ...points.map((point) => point.value));
    const floor = least > 95 ? 90 : least > 50 ? 50 : 0;
    const panels = found.panels.map((panel) => {
      const rates = [...new Set(panel.lines.flatMap((line) => line.points.map((point) => point.x)))].sort((a, b) => a - b);
      return {
        title: panel.title, share: "",
        traces: panel.lines.map((line) => marks(line.series, line.points, {
          x: (point) => point.x, y: (point) => point.value,
          hover: (point) => groupHover(point.group, `${digits(achieved[point.group])} of ${digits(point.x)} Hz achieved`, `${formatRatio(received[point.group])} received`),
        })),
        x: tickedAxis(rates, rates.map(digits), { room: 26, title: "Rate asked for (Hz)" }), y: { type: "linear", range: [floor, 104], nticks: 5 },
      };
    });
    return {
      ...gridOf(panels, width, { yTitle: "Replies (% of rate)", height: 170, below: 46 }), series: found.series, missing: found.missing,
      columns: [...GROUP_COLUMNS, { label: "Achieved", unit: "Hz", format: formatHz }, { label: "Received", unit: "ratio", format: formatRatio }, { label: "Replies", unit: "% of rate", format: digits }],
      rows: points.map((point) => groupRow(point.group, achieved[point.group], received[point.group], point.value)),
    };
  },

  clock(plan, width) {
    const kept = plan.pairs.map((pair) => ({ ...pair, places: pair.group.map((_, place) => place).filter((place) => passes(pair.group[place])) })).filter((pair) => pair.places.length);
    const unit = axisUnit(kept.flatMap((pair) => pair.places.flatMap((place) => [pair.offset_ns[place], pair.bound_ns[place]])));
    const color = theme().parts[1];
    const panels = kept.map((pair) => ({
      title: pair.title,
      traces: [{
        type: "scatter", mode: "markers", name: plain(pair.title), x: pair.places.map((place) => pair.elapsed_s[place]), y: pair.places.map((place) => pair.offset_ns[place] / unit.factor),
        marker: { color, size: 5 }, error_y: { type: "data", array: pair.places.map((place) => pair.bound_ns[place] / unit.factor), color, thickness: 1, width: 2 }, hoverinfo: "text",
        hovertext: pair.places.map((place) => plain(`at ${digits(pair.elapsed_s[place])} s: ${signed(pair.offset_ns[place], formatNs)} ± ${formatNs(pair.bound_ns[place])}`)),
      }],
      x: () => ({ type: "linear", title: axisTitle("Time since the first mark (s)"), zeroline: false }), y: { type: "linear", nticks: 6, zeroline: true },
    }));
    return {
      ...gridOf(panels, width, { yTitle: `Offset since the first (${unit.label})`, below: 46 }), series: new Set(), missing: 0,
      foot: plan.decimated ? "Thinned for drawing: marks are left out at even steps." : "",
      columns: [{ label: "Devices" }, { label: "Time", unit: "s", format: digits }, { label: "Offset", unit: "ns", format: formatNs }, { label: "±", unit: "ns", format: formatNs }],
      rows: kept.flatMap((pair) => pair.places.map((place) => [pair.title, pair.elapsed_s[place], pair.first_offset_ns + pair.offset_ns[place], pair.bound_ns[place]])),
    };
  },

  host_load(plan, width) {
    const cell = shownCell();
    const groups = passingGroups().filter((group) => DATA.groups.cell[group] === cell && plan.groups[group]);
    const latency = DATA.figures.timeline ? DATA.figures.timeline.plan.groups : {};
    const metric = view.metric === "latency" ? "latency_ns" : "rtt_ns";
    const timed = groups.filter((group) => latency[group] && latency[group][metric].some((value) => value !== null));
    const unit = axisUnit(timed.flatMap((group) => latency[group][metric].filter((value) => value !== null)));
    const seconds = () => ({ type: "linear", title: axisTitle("Time since the run's first message (s)"), zeroline: false });
    const dots = timed.map((group) => {
      const points = latency[group].elapsed_s.map((at, place) => ({ at, value: latency[group][metric][place] })).filter((point) => point.value !== null);
      return marks(DATA.groups.series[group], points, { x: (point) => point.at, y: (point) => point.value / unit.factor, mode: "markers", size: 4, hover: (point) => groupHover(group, formatNs(point.value)) });
    });
    const lines = (key, format) => groups.flatMap((group) => plan.groups[group].filter((load) => load[key].some((value) => value !== null)).map((load) => {
      const points = load.elapsed_s.map((at, place) => ({ at, value: load[key][place] })).filter((point) => point.value !== null);
      return marks(DATA.groups.series[group], points, { x: (point) => point.at, y: (point) => point.value, size: 6, open: load.role === "relay", hover: (point) => groupHover(group, `${load.role}: ${format(point.value)}`) });
    }));
    const [cpu, signal] = [lines("cpu_percent", (value) => `${digits(value)} %`), lines("signal_dbm", (value) => `${digits(value)} dBm`)];
    const panels = [];
    if (dots.length) panels.push({ title: `${metric === "latency_ns" ? "Latency" : "Round trip"} (${unit.label})`, traces: dots, x: seconds, y: timeAxis(), height: 130 });
    if (cpu.length) panels.push({ title: "Busiest processor (%)", traces: cpu, x: seconds, y: { type: "linear", range: [-3, 105], nticks: 5 }, height: 110 });
    if (signal.length) panels.push({ title: "Wi-Fi signal (dBm)", traces: signal, x: seconds, y: { type: "linear", nticks: 4 }, height: 110 });
    const drawn = gridOf(cpu.length || signal.length ? panels : [], width, { minWidth: width, below: 46 });
    panels.forEach((_, place) => { if (place && drawn.layout[`xaxis${place + 1}`]) drawn.layout[`xaxis${place + 1}`].matches = "x"; });
    return {
      ...drawn, series: new Set(groups.map((group) => DATA.groups.series[group])), missing: 0,
      foot: `Filled marks are the ping's device, open marks the relay's.${plan.decimated ? " Thinned for drawing: samples are left out at even steps." : ""}`,
      columns: [...GROUP_COLUMNS, { label: "Device" }, { label: "Time", unit: "s", format: digits }, { label: "Busiest processor", unit: "%", format: digits }, { label: "Wi-Fi signal", unit: "dBm", format: digits }],
      rows: groups.flatMap((group) => plan.groups[group].flatMap((load) => load.elapsed_s.map((at, place) => groupRow(group, load.role, at, load.cpu_percent[place], load.signal_dbm[place])))),
    };
  },
});
