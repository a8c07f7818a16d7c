"use strict";
// Figures of the parts of the time, of the two ways, and of the clocks.

/** The axis of a pair's clock offsets, which may be negative. */
function offsetAxis(pair) {
  const ends = pair.places
    .flatMap((place) => [pair.offset_ns[place] - pair.bound_ns[place], pair.offset_ns[place] + pair.bound_ns[place]])
    .map((ns) => ns * S);
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const range = [low - 0.05 * (high - low || S), high + 0.05 * (high - low || S)];
  return { type: "linear", range, ...timeTicks(range), zeroline: true };
}

const WAYS = ["Way out", "Way back"];
// Colour and filling of each part: one hue a way, transport and delivery in tints of it.
const PART_LOOKS = {
  waiting_ns: [0],
  outbound_ns: [1],
  outbound_transport_ns: [1, 0.65],
  relay_delivery_ns: [1, 0.3],
  relay_ns: [2],
  return_ns: [3],
  return_transport_ns: [3, 0.65],
  ping_delivery_ns: [3, 0.3],
};

/** Stacked bars over messages, a panel for each setup and device pair: {data, layout} and their points. */
function stacked(plan, width, all, { found, names, looks, valueOf, hover, ...grid }) {
  const colors = theme();
  const panels = found.panels.map((panel) => {
    const { points } = panel.lines[0];
    return {
      title: panel.title,
      labels: panel.labels,
      weight: points.length,
      share: "all",
      traces: names.map((name) => {
        const [part, tint = 1] = looks[name];
        const color = colors.parts[part];
        return {
          type: "bar",
          name: plan.names[name],
          meta: `part/${name}`,
          x: points.map((_, place) => place),
          y: points.map((point) => valueOf(point.group, name)),
          marker: {
            color: tinted(color, tint),
            opacity: points.map((point) => (isLossy(point.group) ? 0.5 : 1)),
            line: { color: tint < 1 ? color : colors.ground, width: 1 },
          },
          customdata: points.map((point) => point.group),
          hoverinfo: "text",
          hovertext: points.map((point) => hover(point)),
        };
      }),
      ...cellAxis(points.map((point) => DATA.cells[point.x])),
      y: grid.y,
    };
  });
  const drawn = gridOf(panels, width, {
    all,
    minWidth: widthFor(panels, width, 150, 13),
    height: 130,
    ...grid,
  });
  Object.assign(drawn.layout, { barmode: "relative", bargap: 0.15 });
  const lossy = found.points.some(({ group }) => isLossy(group)) ? ` Faded bars ${LOST_MUCH}.` : "";
  return {
    ...drawn,
    parts: names.map((name) => ({
      name: plan.names[name],
      color: colors.parts[looks[name][0]],
      tint: looks[name][1],
    })),
    missing: found.missing,
    foot: `${CELL_FOOT}${lossy}`,
  };
}

Object.assign(KINDS, {
  breakdown(plan, width, all) {
    const partOf = (group, name) => plan.parts[group].find((part) => part.name === name) || null;
    const total = (group) => plan.parts[group].reduce((sum, part) => sum + part.mean_ns, 0);
    const share = (group, name) => {
      const part = partOf(group, name);
      return part ? (100 * part.mean_ns) / total(group) : null;
    };
    const found = collected(plan, total);
    const names = plan.order.filter((name) => found.points.some((point) => partOf(point.group, name)));
    const hover = ({ group, value }) =>
      groupHover(
        group,
        `Mean response: ${formatNs(value)}`,
        ...plan.parts[group].map(
          (part) =>
            `${plan.names[part.name]}: ${digits(share(group, part.name))} %, ${formatNs(part.mean_ns)}` +
            (part.bound_ns ? ` ± ${formatNs(part.bound_ns)}` : ""),
        ),
      );
    const drawn = stacked(plan, width, all, {
      found,
      names,
      looks: PART_LOOKS,
      valueOf: share,
      hover,
      yTitle: "Share of the time",
      y: { type: "linear", range: [0, 100], nticks: 5, ticksuffix: " %" },
    });
    const bounds = found.points.flatMap(({ group }) => plan.parts[group].map((part) => part.bound_ns || 0));
    const bounded = Math.max(0, ...bounds);
    return {
      ...drawn,
      foot:
        drawn.foot +
        (bounded
          ? " Clocks of two devices, or wall and monotonic clock of one, divide there from back and transport from " +
            `delivery to ${formatNs(bounded)} at worst (mean of a result).`
          : ""),
      columns: [
        ...GROUP_COLUMNS,
        { label: "Mean response", unit: "ns", format: formatNs },
        ...names.flatMap((name) => [
          { label: plan.names[name], unit: "ns", format: formatNs },
          { label: "±", unit: "ns", format: formatNs },
        ]),
      ],
      rows: found.points.map(({ group, value }) =>
        groupRow(
          group,
          value,
          ...names.flatMap((name) => {
            const part = partOf(group, name);
            return part ? [part.mean_ns, part.bound_ns] : [null, null];
          }),
        ),
      ),
    };
  },

  one_way(plan, width, all) {
    const valueOf = (group) => {
      const way = plan.ways[group];
      const [out, back] = [way.outbound_ns[view.statistic], way.return_ns[view.statistic]];
      return out === null || back === null ? null : [out, back];
    };
    const found = collected(plan, valueOf);
    const statistic = labelOf("statistic");
    const colors = [theme().parts[1], theme().parts[3]];
    const boundOf = ({ group }) => plan.ways[group].bound_ns || 0;
    const reach = (point) => point.value.flatMap((way) => [way, way - boundOf(point), way + boundOf(point)]);
    const y = timeAxis(found.points.flatMap(reach));
    const panels = found.panels.map((panel) => {
      const { points } = panel.lines[0];
      const traces = [0, 1].map((way) => {
        const look = { ...choiceLook(points[0].group), label: WAYS[way], color: colors[way] };
        const trace = marks(look, points, {
          x: (point) => points.indexOf(point) + (way - 0.5) * 0.3,
          y: (point) => point.value[way] * S,
          mode: "markers",
          size: 8,
          symbol: ["triangle-right", "line-ew-open"][way],
          hover: (point) =>
            groupHover(
              point.group,
              `Way out, ${statistic}: ${formatNs(point.value[0])}`,
              `Way back, ${statistic}: ${formatNs(point.value[1])}`,
              `Clocks: ± ${formatNs(plan.ways[point.group].bound_ns)}`,
            ),
        });
        const bounds = points.map((point) => boundOf(point) * S);
        if (way) Object.assign(trace.marker, { symbol: "line-ew", line: { ...trace.marker.line, width: 2.5 } });
        if (bounds.some((bound) => bound > 0))
          trace.error_y = { type: "data", array: bounds, color: trace.marker.color, thickness: 1.1, width: 3 };
        return trace;
      });
      return {
        title: panel.title,
        labels: panel.labels,
        weight: points.length,
        share: "all",
        traces,
        ...cellAxis(points.map((point) => DATA.cells[point.x])),
        y,
      };
    });
    return {
      ...gridOf(panels, width, {
        all,
        yTitle: timeTitle(`One way, ${statistic}`),
        minWidth: widthFor(panels, width, 200, 18),
        height: 150,
      }),
      parts: WAYS.map((name, way) => ({ name, color: colors[way] })),
      missing: found.missing,
      foot:
        `Where no bar is drawn, ping and relay shared one clock. ${CELL_FOOT}` +
        (found.points.some((point) => isLossy(point.group)) ? ` A hollow triangle ${LOST_MUCH}.` : ""),
      columns: [
        ...GROUP_COLUMNS,
        { label: `Way out, ${statistic}`, unit: "ns", format: formatNs },
        { label: `Way back, ${statistic}`, unit: "ns", format: formatNs },
        { label: "Clock bound", unit: "ns", format: formatNs },
      ],
      rows: found.points.map(({ group, value }) => groupRow(group, ...value, plan.ways[group].bound_ns)),
    };
  },

  clock(plan, width, all) {
    const kept = plan.pairs
      .map((pair) => ({
        ...pair,
        places: pair.group.map((_, place) => place).filter((place) => passes(pair.group[place])),
      }))
      .filter((pair) => pair.places.length);
    const color = theme().parts[1];
    const panels = kept.map((pair) => ({
      title: pair.title,
      traces: [
        {
          type: "scatter",
          mode: "markers",
          name: plain(pair.title),
          x: pair.places.map((place) => pair.elapsed_s[place]),
          y: pair.places.map((place) => pair.offset_ns[place] * S),
          marker: { color, size: 5 },
          error_y: {
            type: "data",
            array: pair.places.map((place) => pair.bound_ns[place] * S),
            color,
            thickness: 1,
            width: 2,
          },
          hoverinfo: "text",
          hovertext: pair.places.map((place) =>
            plain(
              `at ${digits(pair.elapsed_s[place])} s: ` +
                `${signed(pair.offset_ns[place], formatNs)} ± ${formatNs(pair.bound_ns[place])}`,
            ),
          ),
        },
      ],
      x: () => ({ type: "linear", title: axisTitle("Time since the first mark (s)"), zeroline: false }),
      y: offsetAxis(pair),
    }));
    return {
      ...gridOf(panels, width, { yTitle: "Offset since the first", below: 46, all }),
      missing: 0,
      foot: plan.decimated ? "Thinned for drawing: marks are left out at even steps." : "",
      columns: [
        { label: "Devices" },
        { label: "Time", unit: "s", format: digits },
        { label: "Offset", unit: "ns", format: formatNs },
        { label: "±", unit: "ns", format: formatNs },
      ],
      rows: kept.flatMap((pair) =>
        pair.places.map((place) => [
          pair.title,
          pair.elapsed_s[place],
          pair.first_offset_ns + pair.offset_ns[place],
          pair.bound_ns[place],
        ]),
      ),
    };
  },
});
