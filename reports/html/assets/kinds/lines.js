"use strict";
// Marks and lines over sizes, rates, messages or device pairs; tiles over the plane of sizes and rates.

/** What the marks of a plan show: the value of a group, how it is written, and its axis. */
const VALUES = {
  statistic(plan) {
    const metric = plan.metric || view.metric;
    const name = plan.metric
      ? (DATA.metrics.find((one) => one.key === metric) || { label: "Time in relay" }).label
      : labelOf("metric");
    const label = `${name}, ${labelOf("statistic")}`;
    return {
      of: (group) => statisticOf(group, metric),
      label,
      unit: "ns",
      format: formatNs,
      scaled: (value) => value * S,
      title: timeTitle(label),
      axis: timeAxis,
      intervals: !plan.metric,
    };
  },
  own(plan) {
    return {
      of: (group) => plan.values_ns[group],
      label: plan.label,
      unit: "ns",
      format: formatNs,
      scaled: (value) => value * S,
      title: timeTitle(plan.label),
      axis: timeAxis,
    };
  },
  received(plan) {
    const ratios = DATA.values.plain.received_ratio;
    return {
      ...SHARES,
      of: (group) => ratios[group],
      label: plan.label,
    };
  },
  sustained(plan) {
    const { achieved_rate_hz: achieved, received_ratio: received, sustained } = DATA.values.plain;
    return {
      ...SHARES,
      of: (group) => sustained[group],
      label: plan.label,
      further: {
        columns: [
          { label: "Achieved", unit: "Hz", format: formatHz },
          { label: "Received", unit: "ratio", format: formatRatio },
        ],
        cells: (group) => [achieved[group], received[group]],
      },
    };
  },
  transfer(plan) {
    const rates = DATA.values.plain.transfer_rate_bytes_per_s;
    return {
      of: (group) => rates[group],
      label: plan.label,
      unit: "bytes/s",
      format: formatBytesPerS,
      scaled: (value) => value,
      title: `${plan.label} (log scale)`,
      axis: (values) => loadAxis(values),
    };
  },
  spread(plan) {
    const percentile = plan.reaches[view.statistic] ? view.statistic : "p50";
    const label = `${plan.label}, ${DATA.statistics.find((one) => one.key === percentile).label}: ± of a typical run`;
    return {
      of: (group) => plan.reaches[percentile][group],
      label,
      unit: "ratio",
      format: formatRatio,
      scaled: (value) => 100 * value,
      title: "± of a typical run",
      axis: (values) => ({
        type: "linear",
        range: [0, Math.max(1, 108 * Math.max(...values))],
        nticks: 5,
        ticksuffix: " %",
      }),
    };
  },
};

const SHARES = {
  unit: "ratio",
  format: formatRatio,
  scaled: (value) => 100 * value,
  title: "Share",
  size: 9,
  axis(values) {
    const least = 100 * Math.min(1, ...values);
    const floor = least > 99 ? 99 : least > 90 ? 90 : least > 50 ? 50 : 0;
    const top = Math.max(100, 100 * Math.max(...values));
    return {
      type: "linear",
      range: [floor - (top - floor) * 0.04, top + (top - floor) * 0.06],
      nticks: 5,
      ticksuffix: " %",
      startsAt: floor ? `${floor} %` : "",
    };
  },
};

/** The axis along which marks are: {x, notes, shapes, weight, place(point)}; `joined` where lines make sense. */
function alongAxis(x, panel, title, width = Infinity) {
  const points = pointsOf(panel);
  const positions = [...new Set(points.map((point) => point.x))].sort((a, b) => a - b);
  const rank = new Map(positions.map((at, place) => [at, place]));
  const count = panel.lines.length;
  const dodge = (line, width) => (count > 1 ? (line / (count - 1) - 0.5) * width : 0);
  if (x === "load") return { x: () => loadAxis(positions, title), place: (point) => point.x, weight: positions.length };
  if (x === "size" || x === "rate") {
    const of = new Map(points.map((point) => [point.x, x === "size" ? cellOf(point.group).size : digits(point.x)]));
    const span = Math.log10(positions[positions.length - 1] / positions[0]) || 1;
    return {
      x: tickedAxis(
        positions,
        positions.map((at) => of.get(at)),
        { room: x === "size" ? 46 : 24, title },
      ),
      joined: true,
      weight: positions.length,
      place: (point, line) => point.x * 10 ** dodge(line, 0.035 * span * Math.min(1, count / 4)),
    };
  }
  const place = (point, line) => rank.get(point.x) + dodge(line, Math.min(0.66, 0.16 * (count - 1)));
  if (x === "cell" || x === "plane")
    return {
      ...cellAxis(positions.map((at) => DATA.cells[at])),
      place,
      weight: positions.length * Math.max(1, count / 3),
    };
  const labels = positions.map((at) => DATA.dimensions[x].options[at].label);
  const longest = (parts) => Math.max(...labels.flatMap((label) => label.split(parts)).map((part) => part.length));
  const isUpright = Math.min(65, (width - 86) / labels.length) < LETTER * longest(/, | → /);
  return {
    x: optionAxis(labels, isUpright),
    place,
    weight: positions.length * 5,
    below: isUpright ? 6.2 * longest() : 12 * Math.max(1, ...labels.map((label) => label.split(", ").length)),
  };
}

KINDS.lines = function lines(plan, width, all) {
  const value = VALUES[plan.value || "statistic"](plan);
  const found = collected(plan, value.of);
  const { x, lines: dimension } = found.facet;
  const isAlone = (panel) =>
    ["size", "rate", "place"].includes(x) && new Set(pointsOf(panel).map((point) => point.x)).size < 2;
  const kept = found.panels.filter((panel) => !isAlone(panel));
  const every = kept.flatMap(pointsOf);
  const log = value.axis === timeAxis && view.scale === "linear" ? "row" : "all";
  const axes = new Map();
  const intervals = value.intervals && INTERVALS();
  const reach = ({ group, value: own }) => [own, ...(intervals ? intervalOf(group) : [])];
  const axisOf = (panel) => {
    const share = log === "all" ? "all" : panel.row;
    if (!axes.has(share))
      axes.set(
        share,
        value.axis(
          kept
            .filter((one) => log === "all" || one.row === share)
            .flatMap((one) => pointsOf(one).flatMap(reach)),
        ),
      );
    return { share, y: axes.get(share) };
  };
  const panels = kept.map((panel) => {
    const along = alongAxis(x, panel, plan.x_title || AXIS_TITLES[x] || "", width);
    const traces = panel.lines.map((line, place) => {
      const look = lookOf(dimension, line.option);
      const trace = marks(look, line.points, {
        x: (point) => along.place(point, place),
        y: (point) => value.scaled(point.value),
        mode: along.joined ? "lines+markers" : "markers",
        size: value.size || 7,
        hover: (point) =>
          groupHover(
            point.group,
            `${value.label}: ${value.format(point.value)}`,
            ...(intervals ? intervalHover(point.group) : []),
            ...(x === "load" ? [`Offered: ${formatBytesPerS(point.x)}`] : []),
            sampleHover(point.group),
          ),
      });
      const bars = intervals
        ? errorBars(line.points, ({ value: own }) => own, ({ group }) => intervalOf(group), 1 / S, trace.marker.color)
        : undefined;
      return bars ? { ...trace, error_y: bars } : trace;
    });
    const beside = sharesBeside(panel.lines, traces);
    if (x === "load") traces.unshift(diagonal(panel));
    const ends =
      along.joined && !isNarrow(width) && all?.page === undefined && panel.lines.length > 1
        ? panel.lines.map((line, place) => ({
            text: lookOf(dimension, line.option).short,
            color: lookOf(dimension, line.option).color,
            y: traces[place].y[traces[place].y.length - 1],
          }))
        : [];
    const labels = x === "place" ? undefined : panel.labels;
    return { ...along, title: panel.title, labels, traces, ends, beside, ...axisOf(panel) };
  });
  const names =
    every.length && dimension
      ? Math.max(...found.legend.options.map((option) => lookOf(dimension, option).short.length))
      : 0;
  return {
    ...gridOf(panels, width, {
      yTitle: value.title,
      left: value.unit === "bytes/s" ? 80 : 70, // as wide as "10 MB/s", upright title and all
      columns: found.columns,
      all,
      below: ["cell", "plane"].includes(x) ? 40 : 42 + Math.max(0, ...panels.map((panel) => panel.below || 0)),
      minWidth: ["size", "rate"].includes(x)
        ? widthFor(panels, width, isNarrow(width) ? 110 : 150, isNarrow(width) ? 0 : 26)
        : widthFor(panels, width, 240, 13),
      height: value.unit === "ratio" ? 130 : 180,
      right: panels.some((panel) => panel.ends.length) ? Math.min(172, 14 + 6.7 * names) : 16,
    }),
    legend: found.legend,
    missing: found.missing,
    foot: [
      ...leftOutSaid(found.panels.filter(isAlone)),
      ...(["cell", "plane"].includes(x) && panels.length ? [CELL_FOOT] : []),
      ...(every.some((point) => isLossy(point.group)) ? [LOST_FOOT] : []),
    ].join(" "),
    columns: [
      ...GROUP_COLUMNS,
      ...(value.further?.columns || []),
      ...(x === "load" ? [{ label: "Offered", unit: "bytes/s", format: formatBytesPerS }] : []),
      { label: value.label, unit: value.unit, format: value.format },
      ...(intervals ? intervalColumns() : []),
    ],
    rows: found.points.map(({ group, value: own }) =>
      groupRow(
        group,
        ...(value.further?.cells(group) || []),
        ...(x === "load" ? [positionOf(x, group)] : []),
        own,
        ...(intervals ? intervalCells(group) : []),
      ),
    ),
  };
};

const CELL_FOOT = "Numbers below the axis: rate in Hz, and under it the size.";

function leftOutSaid(panels) {
  const titles = panels.length > 8 ? counted(panels.length, "panel") : panels.map(({ title }) => title).join("; ");
  return panels.length ? [`One position only, so not drawn: ${titles}.`] : [];
}

function diagonal(panel) {
  const all = pointsOf(panel).map((point) => point.x);
  const ends = [Math.min(...all), Math.max(...all)];
  return {
    type: "scatter",
    mode: "lines",
    x: ends,
    y: ends,
    hoverinfo: "skip",
    line: { color: theme().soft, dash: "dash", width: 1 },
  };
}

// From fast to slow; every shade is light enough for dark figures in it (WCAG AA), in both themes.
const HEAT = [
  [0, "#fff6d6"],
  [0.5, "#fbc66a"],
  [1, "#e8823a"],
];

KINDS.heatmap = function heatmap(plan, width, all) {
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
  const { across, down } = sidesOf({ x: "plane", panels: "", lines: "" });
  const kept = plan.panels
    .map((panel) => ({
      title: panel.title,
      labels: { row: namesOf(down, panel.tiles[0][2]), column: namesOf(across, panel.tiles[0][2]) },
      tiles: panel.tiles
        .filter(([, , group]) => passes(group))
        .filter(([, , group]) => {
          const has = valueOf(group) !== null;
          if (!has) missing += 1;
          return has;
        }),
    }))
    .filter((panel) => panel.tiles.length);
  const values = kept.flatMap((panel) => panel.tiles.map(([, , group]) => valueOf(group)));
  const least = Math.min(...values),
    most = Math.max(...values);
  const span = { low: log ? shade(least) : Math.min(least, 0.99), high: log ? shade(most) : 1 };
  const isPicture = all?.page !== undefined;
  const [wide, narrow] = isPicture ? [58, 120] : [40, 300];
  const minWidth = Math.max(narrow, ...kept.map((panel) => new Set(panel.tiles.map(([, rate]) => rate)).size * wide));
  const steps = Array.from({ length: 5 }, (_, step) => span.low + ((span.high - span.low) * step) / 4);
  const panels = kept.map((panel, place) => {
    const sizes = new Map(
      panel.tiles.map(([bytes, , group]) => [bytes, cellOf(group).size]).sort((a, b) => a[0] - b[0]),
    );
    const rates = [...new Set(panel.tiles.map(([, rate]) => rate))].sort((a, b) => a - b);
    const rows = [...sizes.keys()];
    const grid = (of) =>
      rows.map((bytes) =>
        rates.map((rate) => {
          const tile = panel.tiles.find(([b, r]) => b === bytes && r === rate);
          return tile ? of(tile[2]) : null;
        }),
      );
    return {
      title: panel.title,
      labels: panel.labels,
      height: Math.max(34, 28 * rows.length),
      traces: [
        {
          type: "heatmap",
          z: grid((group) => shade(valueOf(group))),
          text: grid(
            (group) =>
              format(valueOf(group)).replace(" ", "\u00a0") +
              (isLossy(group) && view.tiles === "statistic" ? `<br>${lossText(group)}` : ""),
          ),
          customdata: grid((group) => group),
          hovertext: grid((group) => groupHover(group, `${label}: ${format(valueOf(group))}`, sampleHover(group))),
          hoverinfo: "text",
          texttemplate: minWidth / rates.length >= 46 ? "%{text}" : undefined,
          textfont: { size: isPicture ? 9 : 12, color: "#1b1f24" },
          xgap: 2,
          ygap: 2,
          colorscale: HEAT,
          reversescale: view.tiles !== "statistic",
          zmin: span.low,
          zmax: span.high === span.low ? span.low + 1 : span.high,
          showscale: place === 0,
          colorbar: {
            thickness: 12,
            lenmode: "pixels",
            len: 150,
            y: 1,
            yanchor: "top",
            outlinewidth: 0,
            tickmode: "array",
            tickvals: steps,
            ticktext: steps.map((step) => plain(format(log ? 10 ** step : step))),
            tickfont: { size: 12, color: theme().soft },
          },
        },
      ],
      x: () => ({
        type: "linear",
        tickmode: "array",
        tickvals: rates.map((_, i) => i),
        ticktext: rates.map((rate) => (rate ? digits(rate) : "max")),
        showgrid: false,
        zeroline: false,
        title: axisTitle(AXIS_TITLES.rate),
      }),
      y: {
        type: "linear",
        tickmode: "array",
        tickvals: rows.map((_, i) => i),
        ticktext: rows.map((bytes) => plain(sizes.get(bytes))),
        showgrid: false,
        zeroline: false,
      },
    };
  });
  return {
    ...gridOf(panels, width, { minWidth: Math.min(minWidth, width - 80), right: 84, below: 46, all }),
    missing,
    foot:
      `Tiles show: ${label}.` +
      (view.tiles === "statistic" && kept.some((panel) => panel.tiles.some(([, , group]) => isLossy(group)))
        ? ` A percentage in a tile is the share received of what ${LOST_MUCH}.`
        : ""),
    columns: [...GROUP_COLUMNS, { label, unit, format }],
    rows: kept.flatMap((panel) => panel.tiles.map(([, , group]) => groupRow(group, valueOf(group)))),
  };
};

KINDS.fan_out = function fanOut(plan, width, all) {
  const lines = Object.entries(plan.lines)
    .map(([name, points]) => ({ name, points: points.filter((point) => passes(point.group)) }))
    .filter(({ points }) => points.length);
  const vendors = lines.map(({ points }) => optionOf("vendor", points[0].group));
  const areVendors = new Set(vendors).size === lines.length;
  lines.forEach((line, at) => {
    const look = areVendors ? lookOf("vendor", vendors[at]) : choiceLook(line.points[0].group);
    line.look = { ...look, label: line.name };
  });
  const panel = (title, key, label) => ({
    title,
    traces: lines.map(({ look, points }) => {
      const shown = points.filter((point) => point[key] !== null);
      const hover = (point) =>
        groupHover(point.group, `${plan.of}: ${point.count}`, `${label}: ${formatNs(point[key])}`);
      const trace = marks(look, shown, { x: (point) => point.count, y: (point) => point[key] * S, hover });
      if (key !== "last_ns") return trace;
      const ends = (point) => [point.first_ns, point.last_ns];
      return { ...trace, error_y: errorBars(shown, (point) => point[key], ends, 1 / S, trace.marker.color) };
    }),
    x: countAxis(
      lines.flatMap(({ points }) => points.map((one) => one.count)),
      plan.of,
    ),
    y: timeAxis(
      lines.flatMap(({ points }) => points.flatMap((one) => (key === "last_ns" ? [one.first_ns, one[key]] : one[key]))),
    ),
  });
  const panels = [
    panel("First to last receiver", "last_ns", "Last"),
    panel("Until all have matched", "matched_ns", "Matched"),
  ];
  const times = ["First receiver p50", "Last receiver p50", "Matched p50"];
  return {
    ...gridOf(lines.length ? panels : [], width, { yTitle: timeTitle("Time, p50"), height: 190, below: 46, all }),
    parts: lines.map(({ name, look }) => ({ name, color: look.color })),
    missing: 0,
    columns: [
      ...GROUP_COLUMNS,
      { label: plan.of, format: formatCount },
      ...times.map((label) => ({ label, unit: "ns", format: formatNs })),
    ],
    rows: lines.flatMap(({ points }) =>
      points.map((one) => groupRow(one.group, one.count, one.first_ns, one.last_ns, one.matched_ns)),
    ),
  };
};
