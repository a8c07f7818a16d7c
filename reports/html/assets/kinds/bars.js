"use strict";
// Bars of the planned messages, and what a bridge costs.

/** The chosen time of a group over the messages planned, in ns; Infinity where it is of a lost one, null if too few. */
function plannedTime(plan, group) {
  const of = plan.planned[group];
  if (!of) return statisticOf(group);
  const value = of[view.metric][view.statistic];
  return value === null ? Infinity : (value ?? null);
}

/** A difference between two times of which the other may be lost: `+2.1 ms`, `lost`. */
const differenceText = (base, other) =>
  other === Infinity ? "lost" : base === Infinity ? "" : signed(other - base, formatNs);

KINDS.bars = function bars(plan, width, all) {
  const own = plan.facet;
  const facet = chosenFacet({ ...own, x: view.bars, panels: view.bars === own.x ? own.panels : own.x });
  const found = collected(plan, (group) => plannedTime(plan, group), facet);
  const base = new Map(plan.pairs.map(([same, different]) => [different, same]));
  const isPicture = all?.page !== undefined; // its panels are too low for more than a number
  const finite = (panels) => panels.flatMap(pointsOf).map(({ value }) => value).filter(Number.isFinite);
  const tops = new Map(
    found.panels.map((panel) => [
      panel.row,
      (found.points.some((point) => isLossy(point.group)) ? 1.5 : 1.22) *
        S *
        Math.max(1, ...finite(found.panels.filter((one) => one.row === panel.row))),
    ]),
  );
  const barsIn = (panel) => new Set(pointsOf(panel).map((point) => point.x)).size * panel.lines.length;
  const minWidth = Math.min(width - 80, Math.max(150, ...found.panels.map((panel) => 11 * barsIn(panel))));
  const panels = found.panels.map((panel) => {
    const positions = [...new Set(pointsOf(panel).map((point) => point.x))].sort((a, b) => a - b);
    const top = tops.get(panel.row);
    const names = positions.map((at) => {
      const { group } = pointsOf(panel).find((point) => point.x === at);
      return facet.x === "size" ? cellOf(group).size : facet.x === "rate" ? digits(at) : labelIn(facet.x, group);
    });
    const thick = (0.75 * minWidth) / (positions.length * panel.lines.length);
    return {
      title: panel.title,
      labels: panel.labels,
      share: panel.row,
      traces: panel.lines.map((line) => {
        const look = lookOf(facet.lines, line.option);
        const lost = line.points.map((point) => point.value === Infinity);
        return {
          type: "bar",
          name: plain(look.label),
          meta: look.key,
          x: line.points.map((point) => positions.indexOf(point.x)),
          y: line.points.map((point) => (point.value === Infinity ? top : point.value * S)),
          text: line.points.map((point, place) =>
            isLossy(point.group)
              ? lossText(point.group)
              : !isPicture && thick > 12 && base.has(point.group) && !lost[place]
                ? differenceText(plannedTime(plan, base.get(point.group)), point.value)
                : "",
          ),
          textposition: lost.map((is) => (is ? "inside" : "outside")),
          insidetextanchor: "start",
          insidetextfont: { size: isPicture ? 9 : 12, color: theme().ink },
          outsidetextfont: { size: isPicture ? 9 : 12, color: theme().ink },
          textangle: -90,
          cliponaxis: false,
          constraintext: "none",
          customdata: line.points.map((point) => point.group),
          hoverinfo: "text",
          hovertext: line.points.map((point) =>
            groupHover(
              point.group,
              `${statisticLabel()}, of the planned messages: ` +
                (point.value === Infinity ? "lost" : formatNs(point.value)),
              ...(base.has(point.group)
                ? [`${differenceText(plannedTime(plan, base.get(point.group)), point.value)} against the same domain`]
                : []),
              sampleHover(point.group),
            ),
          ),
          marker: {
            color: tinted(look.color, look.tint),
            opacity: lost.map((is) => (is ? 0.35 : 1)),
            line: { color: look.color, width: 1 },
            pattern: {
              shape: lost.map((is) => (is ? "x" : "")),
              fgcolor: look.color,
              bgcolor: theme().ground,
              size: 6,
              solidity: 0.45,
            },
          },
        };
      }),
      x: (panelWidth) => ({
        ...tickedAxis(
          positions.map((_, place) => place),
          names,
          { log: false, room: facet.x === "size" ? 40 : 20, title: AXIS_TITLES[facet.x] },
        )(panelWidth),
        range: [-0.55, positions.length - 0.45],
        showgrid: false,
      }),
      y: { type: "linear", range: [0, top], ...timeTicks([0, top]) },
    };
  });
  const drawn = gridOf(panels, width, {
    yTitle: `${statisticLabel()} (of all planned)`,
    minWidth,
    height: 150,
    below: 42,
    columns: found.columns,
    all,
  });
  Object.assign(drawn.layout, { barmode: "group", bargap: 0.25, bargroupgap: 0.06 });
  const pairs = plan.pairs
    .filter((pair) => pair.every(passes))
    .map(([same, different]) => ({
      same,
      different,
      times: [same, different].map((group) => plannedTime(plan, group)),
    }))
    .filter(({ times }) => times.every((time) => time !== null));
  const cell = (time) => (time === Infinity ? "lost" : time);
  return {
    ...drawn,
    legend: found.legend,
    missing: found.missing,
    foot: found.points.some((point) => isLossy(point.group))
      ? "A percentage at a bar is the share received; a crossed-out bar lost so many that its time is a lost message."
      : "",
    columns: [
      ...GROUP_COLUMNS,
      { label: "Same domain", unit: "ns", format: formatNs },
      { label: "Different domains", unit: "ns", format: formatNs },
      { label: "Difference", unit: "ns", format: (value) => signed(value, formatNs) },
      { label: "Ratio", unit: "ratio", format: digits },
      { label: "Received" },
    ],
    rows: pairs.map(({ same, different, times: [base_, other] }) =>
      groupRow(
        different,
        cell(base_),
        cell(other),
        ...([base_, other].every(Number.isFinite) ? [other - base_, other / base_] : ["lost", "lost"]),
        plan.received[different],
      ),
    ),
  };
};

KINDS.bridge_cost = function bridgeCost(plan, width, all) {
  const instead = plan.instead[view.statistic]; // only percentiles are compared
  const statistic = instead || view.statistic;
  const label = DATA.statistics.find((choice) => choice.key === statistic).label;
  const costOf = (group) => plan.cells[group].costs[statistic] || null;
  const found = collected(plan, costOf);
  const hasLoads = Object.values(plan.cells).some((cell) => cell.bridge_cpu_percent !== null);
  const cpu = (group) =>
    plan.cells[group].bridge_cpu_percent === null
      ? []
      : [`Bridge: ${digits(plan.cells[group].bridge_cpu_percent)} % of a processor`];
  const ends = (key) =>
    found.points
      .flatMap(({ value }) => [value[key], value[`${key}_low`], value[`${key}_high`]])
      .filter((value) => value > 0 && value < 20 * Math.max(...found.points.map((point) => point.value[key] || 0), 1));
  const ratios = [...ends("ratio"), 1, 1.2];
  const range = logRange(Math.min(...ratios), Math.max(...ratios));
  const tickvals = logTicks(10 ** range[0], 10 ** range[1], 6);
  const ticktext = tickvals.map((value) => `×${digits(value)}`);
  const ratioAxis = { type: "log", range, tickmode: "array", tickvals, ticktext, minor: { showgrid: false } };
  /** Differences of one row of panels share an axis: a message of 4 MB must not flatten those of 300 bytes. */
  const differenceAxis = (row) => {
    const values = found.panels
      .filter((panel) => panel.row === row)
      .flatMap((panel) =>
        pointsOf(panel).flatMap(({ value }) => [
          value.difference_ns,
          value.low_ns ?? 0,
          Math.min(value.high_ns ?? 0, 3 * Math.abs(value.difference_ns)),
        ]),
      );
    const low = S * Math.min(0, ...values),
      high = S * Math.max(0, ...values);
    const range = [low - 0.05 * (high - low || S), high + 0.08 * (high - low || S)];
    return {
      type: "linear",
      range,
      ...timeTicks(range),
      zeroline: true,
      zerolinewidth: 2,
      zerolinecolor: theme().soft,
    };
  };
  const panels = found.panels.flatMap((panel) =>
    ["ratio", "difference"].map((key) => {
      const along = alongAxis("plane", panel, "");
      const scale = key === "ratio" ? 1 : S;
      const of = (cost) =>
        key === "ratio"
          ? [cost.ratio, cost.ratio_low, cost.ratio_high]
          : [cost.difference_ns, cost.low_ns, cost.high_ns];
      const traces = panel.lines.map((line, place) => {
        const trace = marks(lookOf(found.facet.lines, line.option), line.points, {
          x: (point) => along.place(point, place),
          y: (point) => (of(point.value)[0] === null ? null : of(point.value)[0] * scale),
          mode: "markers",
          size: 7,
          hover: ({ group, value }) =>
            groupHover(
              group,
              `${label}: ×${digits(value.ratio ?? 0)} ` +
                `(95 %: ×${digits(value.ratio_low ?? 0)} to ×${digits(value.ratio_high ?? 0)})`,
              `${signed(value.difference_ns, formatNs)} ` +
                `(95 %: ${formatNs(value.low_ns)} to ${formatNs(value.high_ns)})`,
              `Runs: ${value.runs}`,
              `Received: ${value.received}`,
              ...cpu(group),
            ),
        });
        const [valueOf, endsOf] = [({ value }) => of(value)[0], ({ value }) => of(value).slice(1)];
        trace.error_y = errorBars(line.points, valueOf, endsOf, 1 / scale, trace.line.color);
        return trace;
      });
      return {
        ...along,
        traces,
        beside: key === "ratio" ? sharesBeside(panel.lines, traces) : [],
        labels: { row: panel.title, column: key === "ratio" ? "Times as long" : "Difference" },
        title: (key === "ratio" ? "Times as long" : "Difference") + (found.panels.length > 1 ? `, ${panel.title}` : ""),
        share: key === "ratio" ? key : `difference ${panel.row}`,
        y: key === "ratio" ? ratioAxis : differenceAxis(panel.row),
        shapes: [
          ...along.shapes,
          ...(key === "ratio"
            ? [
                (colors, suffix) => ({
                  type: "line",
                  xref: `x${suffix} domain`,
                  x0: 0,
                  x1: 1,
                  y0: 1,
                  y1: 1,
                  yref: `y${suffix}`,
                  line: { color: colors.soft, width: 2 },
                  layer: "below",
                }),
              ]
            : []),
        ],
      };
    }),
  );
  return {
    ...gridOf(panels, width, {
      yTitle: `Latency, ${label}`,
      minWidth: widthFor(panels, width, 260, 12),
      height: 190,
      columns: 2,
      all,
    }),
    legend: found.legend,
    missing: found.missing,
    foot: [
      instead ? `Compared: the ${label} of the latency, as only percentiles are.` : "",
      "The ratio is on a log scale.",
      CELL_FOOT,
      found.points.some((point) => isLossy(point.group)) ? LOST_FOOT : "",
      plan.foot,
    ]
      .filter(Boolean)
      .join(" "),
    columns: [
      ...GROUP_COLUMNS,
      { label: `Ratio, ${label}`, unit: "ratio", format: digits },
      { label: "Ratio 95 % low", unit: "ratio", format: digits },
      { label: "Ratio 95 % high", unit: "ratio", format: digits },
      { label: `Added, ${label}`, unit: "ns", format: (value) => signed(value, formatNs) },
      LOW,
      HIGH,
      { label: "Runs" },
      { label: "Received" },
      { label: "Verdict" },
      ...(hasLoads ? [{ label: "Bridge CPU", unit: "% of a processor", format: digits }] : []),
    ],
    rows: found.points.map(({ group, value }) =>
      groupRow(
        group,
        value.ratio,
        value.ratio_low,
        value.ratio_high,
        value.difference_ns,
        value.low_ns,
        value.high_ns,
        value.runs,
        value.received,
        value.verdict,
        ...(hasLoads ? [plan.cells[group].bridge_cpu_percent] : []),
      ),
    ),
  };
};
