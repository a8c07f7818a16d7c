"use strict";
// Figures of one message (data, size and rate) on one device pair.

const choicesOf = (groups) => ({
  dimension: "choice",
  options: [...new Set(groups.map((group) => optionOf("choice", group)))].sort((a, b) => a - b),
});
const cellTitle = () =>
  shownCell() === null
    ? ""
    : [DATA.cells[shownCell()].label, varies("place") ? DATA.dimensions.place.options[shownPlace()].label : ""]
        .filter(Boolean)
        .join(", ");
/** The groups that these figures show: without lines that the reader hid, and no more than can be distinguished. */
const seenInCell = (groups) =>
  groups.filter((group) => !isHidden("choice", optionOf("choice", group))).slice(0, MOST_LINES);

const secondsAxis = () => ({
  type: "linear",
  title: axisTitle("Time since the run's first message (s)"),
  zeroline: false,
});

/** The field and the name of the time that is drawn of each message. */
const messageTime = () => (view.metric === "latency" ? ["latency_ns", "Latency"] : ["rtt_ns", "Round trip"]);

/** A dot for each received message of some groups, at its time within the run. */
const messageDots = (timelines, groups, metric, size, hover) =>
  groups.map((group) => {
    const points = timelines[group].elapsed_s
      .map((at, place) => ({ at, value: timelines[group][metric][place] }))
      .filter((point) => point.value !== null);
    return marks(choiceLook(group), points, {
      x: (point) => point.at,
      y: (point) => point.value * S,
      mode: "markers",
      size,
      hover: (point) => hover(group, point),
    });
  });

// Axes of what is sampled; what a file drives has steps from 0.
const LOAD_AXES = { cpu_percent: { range: [-3, 105], nticks: 5 }, signal_dbm: { nticks: 4 } };

Object.assign(KINDS, {
  percentile_curve(_, width, all) {
    return distribution(width, true, all);
  },
  ecdf(_, width, all) {
    return distribution(width, false, all);
  },

  timeline(plan, width, all) {
    const inCell = cellGroups().filter((group) => plan.groups[group]);
    const groups = seenInCell(inCell);
    const [metric, label] = messageTime();
    const values = groups.flatMap((group) => plan.groups[group][metric].filter((value) => value !== null));
    const lossy = groups.filter((group) => plan.groups[group].lost_elapsed_s.length);
    const dots = messageDots(plan.groups, groups, metric, 4.5, (group, point) =>
      groupHover(group, `at ${digits(point.at)} s`, `${label}: ${formatNs(point.value)}`),
    );
    for (const trace of dots) trace.marker.opacity = 0.75;
    const crosses = lossy.map((group, place) => {
      const { lost_elapsed_s: at, lost_count: count } = plan.groups[group];
      const trace = marks(
        choiceLook(group),
        at.map((second, index) => ({ second, count: count[index] })),
        {
          x: (point) => point.second,
          y: () => lossy.length - place,
          mode: "markers",
          size: 8,
          hover: (point) => groupHover(group, `${formatCount(point.count)} lost at ${digits(point.second)} s`),
        },
      );
      trace.marker = { ...trace.marker, symbol: "x-thin-open" };
      trace.yaxis = "y2";
      return trace;
    });
    const panel = {
      title: cellTitle(),
      traces: dots,
      x: secondsAxis,
      y: timeAxis(values),
    };
    const drawn = gridOf(values.length || lossy.length ? [panel] : [], width, {
      yTitle: timeTitle(label),
      height: 190,
      below: 46,
      all,
    });
    if (drawn.layout.yaxis) {
      for (const group of groups) {
        for (const [start, end] of plan.outages[group] || []) {
          drawn.layout.shapes.push({
            type: "rect",
            xref: "x",
            yref: "y domain",
            x0: start,
            x1: end,
            y0: 0,
            y1: 1,
            layer: "below",
            fillcolor: choiceLook(group).color,
            opacity: 0.16,
            line: { width: 0 },
          });
        }
      }
    }
    if (lossy.length && drawn.layout.yaxis) {
      const [bottom, top] = drawn.layout.yaxis.domain;
      const strip = top - Math.min(0.3, 0.06 + 0.045 * lossy.length) * (top - bottom);
      drawn.layout.yaxis.domain = [bottom, strip];
      drawn.layout.yaxis2 = {
        ...axisStyle(theme()),
        domain: [strip + 0.02, top],
        anchor: "x",
        range: [0.3, lossy.length + 0.7],
        tickmode: "array",
        tickvals: [(lossy.length + 1) / 2],
        ticktext: ["lost"],
        showgrid: false,
        zeroline: false,
        fixedrange: true,
      };
      drawn.data.push(...crosses);
    }
    return {
      ...drawn,
      legend: choicesOf(inCell),
      missing: 0,
      foot: plan.decimated
        ? "Thinned for drawing: each slice of time has its fastest and slowest message, and every loss is counted."
        : "",
      columns: [
        ...GROUP_COLUMNS,
        { label: "Time", unit: "s", format: digits },
        { label, unit: "ns", format: formatNs },
        { label: "Lost", unit: "messages", format: formatCount },
      ],
      rows: groups.flatMap((group) => [
        ...plan.groups[group].elapsed_s.map((at, place) => groupRow(group, at, plan.groups[group][metric][place], 0)),
        ...plan.groups[group].lost_elapsed_s.map((at, place) =>
          groupRow(group, at, null, plan.groups[group].lost_count[place]),
        ),
      ]),
    };
  },

  host_load(plan, width) {
    const inCell = cellGroups().filter((group) => plan.groups[group]);
    const groups = seenInCell(inCell);
    const latency = DATA.figures.timeline ? DATA.figures.timeline.plan.groups : {};
    const [metric, title] = messageTime();
    const timed = groups.filter((group) => latency[group] && latency[group][metric].some((value) => value !== null));
    const values = timed.flatMap((group) => latency[group][metric].filter((value) => value !== null));
    const dots = messageDots(latency, timed, metric, 4, (group, point) => groupHover(group, formatNs(point.value)));
    const lines = (key, unit) =>
      groups.flatMap((group) =>
        plan.groups[group]
          .filter((load) => load[key].some((value) => value !== null))
          .map((load) => {
            const points = load.elapsed_s
              .map((at, place) => ({ at, value: load[key][place] }))
              .filter((point) => point.value !== null);
            const trace = marks(choiceLook(group), points, {
              x: (point) => point.at,
              y: (point) => point.value,
              size: 6,
              ...(key in LOAD_AXES ? {} : { mode: "lines" }),
              hover: (point) => groupHover(group, `${load.role}: ${digits(point.value)} ${unit}`),
            });
            if (!(key in LOAD_AXES)) trace.line = { ...trace.line, shape: "hv" };
            else if (load.role === "relay")
              Object.assign(trace.marker, { size: 8, line: { color: theme().ink, width: 1.6 } });
            return trace;
          }),
      );
    const loads = plan.loads
      .map(([key, label, unit]) => ({
        title: `${label} (${unit})`,
        traces: lines(key, unit),
        x: secondsAxis,
        y: { type: "linear", ...(LOAD_AXES[key] ?? { rangemode: "tozero", nticks: 4 }) },
        height: 90,
      }))
      .filter((panel) => panel.traces.length);
    const times = dots.length ? [{ title, traces: dots, x: secondsAxis, y: timeAxis(values), height: 110 }] : [];
    const panels = [...times, ...loads];
    const drawn = gridOf(loads.length ? panels : [], width, { minWidth: width, below: 46 });
    panels.forEach((_, place) => {
      if (place && drawn.layout[`xaxis${place + 1}`]) drawn.layout[`xaxis${place + 1}`].matches = "x";
    });
    return {
      ...drawn,
      legend: choicesOf(inCell),
      missing: 0,
      foot: plan.decimated ? "Thinned for drawing: samples are left out at even steps." : "",
      columns: [
        ...GROUP_COLUMNS,
        { label: "Device" },
        { label: "Time", unit: "s", format: digits },
        ...plan.loads.map(([, label, unit]) => ({ label, unit, format: digits })),
      ],
      rows: groups.flatMap((group) =>
        plan.groups[group].flatMap((load) =>
          load.elapsed_s.map((at, place) =>
            groupRow(group, load.role, at, ...plan.loads.map(([key]) => load[key][place])),
          ),
        ),
      ),
    };
  },
});

/** One message in how many is beyond a share. */
const rarity = (share) => 1 / (1 - share);

/** Percentiles that a group's sample supports with their intervals, both of a typical run where one is known. */
function namedPercentiles(group, width) {
  const times = DATA.values.times_ns[view.metric];
  const valueOf = ({ key }) => typicalOf(group, key) ?? times[key][group];
  return DATA.percentiles
    .filter(({ share }) => share !== 0.95 || !isNarrow(width)) // its label has no room next to p90
    .map((one) => ({ ...one, at: rarity(one.share), value: valueOf(one), ends: intervalOf(group, one.key) }))
    .filter((one) => one.value !== null && one.ends.some((end) => end !== null));
}

function percentileMarks(group, width) {
  const named = namedPercentiles(group, width);
  if (!named.length) return [];
  const trace = marks(choiceLook(group), named, {
    x: (one) => one.at,
    y: (one) => one.value * S,
    mode: "markers",
    size: 6,
    hover: (one) =>
      groupHover(
        group,
        `${one.label}: ${formatNs(one.value)}`,
        `95 %: ${formatNs(one.ends[0])} to ${formatNs(one.ends[1])}`,
        restsOn(group, one.key),
      ),
  });
  trace.error_y = errorBars(named, (one) => one.value, (one) => one.ends, 1 / S, trace.marker.color);
  return [trace];
}

/** Both figures of a distribution: the tail of the received messages by rarity, or the share of the planned in time. */
function distribution(width, byRarity, all) {
  const {
    values_ns: { [view.metric]: curves },
    levels,
    shares,
  } = DATA.curves;
  const inCell = cellGroups();
  const groups = seenInCell(inCell).filter((group) => curves[group].length > 1);
  const without = inCell.filter((group) => curves[group].length <= 1).length;
  // A curve by share ends at the slowest received message, at the share received.
  const last = (group) =>
    Math.max(curves[group][curves[group].length - 1], DATA.values.times_ns[view.metric].max[group] ?? 0);
  const pointsOf = (group) => [
    ...curves[group].map((value, place) => ({ value, level: levels[place] })),
    ...(byRarity ? [] : [{ value: last(group), level: 1 }]),
  ];
  const valueTitle = timeTitle(labelOf("metric"));
  const marked = byRarity ? groups.flatMap((group) => namedPercentiles(group, width)) : [];
  const drawn = [...groups.flatMap(pointsOf), ...marked].map((point) => point.value);
  const values = drawn.concat(marked.flatMap(({ ends }) => ends));
  const lines = (x, y, said) =>
    groups.map((group) => {
      const trace = marks(choiceLook(group), pointsOf(group), {
        x: (point) => x(point, group),
        y: (point) => y(point, group),
        mode: "lines",
        hover: (point) => groupHover(group, said(point, group), sampleHover(group)),
      });
      trace.line.width = 2.2;
      if (isLossy(group)) trace.opacity = 0.55;
      return trace;
    });
  const common = {
    legend: choicesOf(inCell),
    missing: without,
    foot:
      (marked.length ? "Marks and 95 % bars are of a typical run from three runs on, curves of all messages. " : "") +
      (groups.some(isLossy) ? `Faded curves ${LOST_MUCH}.` : ""),
  };
  if (byRarity) {
    const isTick = (level) => level === 0.5 || (level > 0.5 && Number.isInteger(Math.log10(Math.round(rarity(level)))));
    const ticks = [...levels.filter(isTick), ...(isNarrow(width) ? [] : [0.95])];
    const deepest = Math.max(...groups.map((group) => rarity(levels[curves[group].length - 1])));
    const panel = {
      title: cellTitle(),
      y: timeAxis(values),
      traces: lines(
        (point) => rarity(point.level),
        (point) => point.value * S,
        (point) => `p${digits(100 * point.level)}: ${formatNs(point.value)}`,
      ).concat(groups.flatMap((group) => percentileMarks(group, width))),
      x: () => ({
        type: "log",
        range: [0, Math.log10(Math.max(deepest, 10)) + 0.05],
        tickmode: "array",
        tickvals: ticks.map(rarity),
        ticktext: ticks.map((level) => `p${percent(level)}`),
        title: axisTitle("Percentile of the received messages"),
      }),
    };
    return {
      ...gridOf(groups.length ? [panel] : [], width, { yTitle: valueTitle, height: 210, below: 46, all }),
      ...common,
      columns: [
        ...GROUP_COLUMNS,
        { label: "Percentile", unit: "%", format: digits },
        { label: labelOf("metric"), unit: "ns", format: formatNs },
      ],
      rows: groups.flatMap((group) =>
        pointsOf(group).map(({ value, level }) => groupRow(group, percent(level), value)),
      ),
    };
  }
  const panel = {
    title: `Planned messages, ${cellTitle()}`,
    y: { type: "linear", range: [-2, 102], nticks: 6, ticksuffix: " %" },
    traces: lines(
      (point) => point.value * S,
      (point, group) => 100 * point.level * shares[group],
      (point, group) =>
        `${formatRatio(point.level * shares[group])} of the planned messages within ${formatNs(point.value)}`,
    ),
    x: (width) => ({ ...timeAxis(values, Math.min(6, Math.floor(width / 60))), title: axisTitle(valueTitle) }),
  };
  return {
    ...gridOf(groups.length ? [panel] : [], width, { yTitle: "Messages", height: 210, below: 46, all }),
    ...common,
    columns: [
      ...GROUP_COLUMNS,
      { label: "Share of planned", unit: "%", format: digits },
      { label: "Share of received", unit: "%", format: digits },
      { label: labelOf("metric"), unit: "ns", format: formatNs },
    ],
    rows: groups.flatMap((group) =>
      pointsOf(group).map(({ value, level }) => groupRow(group, percent(level * shares[group]), percent(level), value)),
    ),
  };
}
