"use strict";
// Kinds of figures about the wire. As in kinds.js.

// Colour and filling of each part of a message's cost; only what is left over is hatched.
const WIRE_LOOKS = { data: [1], again: [0], control: [2], discovery: [3], other: [3, "/"] };

Object.assign(KINDS, {
  wire_cost(plan, width) {
    const colors = theme();
    const used = Object.keys(plan.names);
    const partOf = (group, name) => plan.parts[group].find((part) => part.name === name) || null;
    const found = collected(plan, (group) => (plan.parts[group] || []).reduce((sum, part) => sum + part.ratio, 0) || null);
    const points = found.panels.flatMap((panel) => panel.lines.flatMap((line) => line.points));
    const hover = (point) => groupHover(point.group, `${digits(point.value)} bytes per payload byte`, ...plan.parts[point.group].map((part) => `${plan.names[part.name]}: ${digits(part.ratio)} (${formatRatio(part.share)})`));
    const panels = found.panels.map((panel) => {
      const shown = panel.lines.flatMap((line) => line.points);
      return {
        title: panel.title, weight: shown.length,
        traces: used.map((name) => {
          const color = colors.parts[WIRE_LOOKS[name][0]];
          const hatch = WIRE_LOOKS[name][1];
          return {
            type: "bar", name: plan.names[name], x: shown.map((_, place) => place), y: shown.map((point) => { const part = partOf(point.group, name); return part ? part.ratio : null; }),
            marker: { color, line: { color, width: hatch ? 1 : 0 }, pattern: hatch ? { shape: hatch, fgcolor: color, bgcolor: colors.ground, size: 5, solidity: 0.4 } : {} },
            hoverinfo: "text", hovertext: shown.map(hover),
          };
        }),
        ...cellAxis(shown.map((point) => DATA.cells[point.x])),
        y: { type: "linear", rangemode: "tozero", nticks: 5 },
      };
    });
    const most = Math.max(1, ...panels.map((panel) => panel.weight));
    const drawn = gridOf(panels, width, { yTitle: "Bytes per payload byte", minWidth: Math.min(width, Math.max(300, most * 15)), height: 190 });
    Object.assign(drawn.layout, { barmode: "relative", bargap: 0.2 });
    const low = points.filter((point) => plan.incomplete.includes(point.group)).length;
    return {
      ...drawn, series: new Set(), parts: used.map((name) => ({ name: plan.names[name], color: colors.parts[WIRE_LOOKS[name][0]], hatched: Boolean(WIRE_LOOKS[name][1]) })), missing: found.missing,
      foot: `Numbers below the axis: rate in Hz, and under it the size.${low ? ` The kernel dropped packets of ${counted(low, "group")}, whose bars are too low.` : ""}`,
      columns: [...GROUP_COLUMNS, { label: "Bytes per payload byte", unit: "ratio", format: digits }, ...used.map((name) => ({ label: plan.names[name], unit: "share of bytes", format: formatRatio }))],
      rows: points.map((point) => groupRow(point.group, point.value, ...used.map((name) => { const part = partOf(point.group, name); return part ? part.share : null; }))),
    };
  },

  sent_again(plan, width) {
    const cell = shownCell();
    const groups = passingGroups().filter((group) => DATA.groups.cell[group] === cell && plan.groups[group]);
    const label = plan.metric === "latency" ? "Latency" : "Round trip";
    const timed = (group) => plan.groups[group].filter((point) => point.p50_ns !== null);
    const unit = axisUnit(groups.flatMap((group) => timed(group).map((point) => point.max_ns)));
    const panel = {
      title: cell === null ? "" : DATA.cells[cell].label,
      traces: groups.map((group) => {
        const points = timed(group);
        const trace = marks(DATA.groups.series[group], points, {
          x: (point) => point.repeats, y: (point) => point.p50_ns / unit.factor, size: 8,
          hover: (point) => groupHover(group, `sent again ${counted(point.repeats, "time")}: ${counted(point.messages, "message")}`, `${label} p50: ${formatNs(point.p50_ns)}, max: ${formatNs(point.max_ns)}`),
        });
        trace.error_y = errorBars(points.map((point) => point.p50_ns), points.map((point) => [point.p50_ns, point.max_ns]), unit.factor, trace.marker.color);
        return trace;
      }),
      x: () => ({ type: "linear", title: axisTitle("Sent again, times"), zeroline: false, rangemode: "tozero", tickformat: "d" }), y: timeAxis(),
    };
    return {
      ...gridOf(groups.length ? [panel] : [], width, { yTitle: `${label} (${unit.label})`, height: 260, below: 46 }),
      series: new Set(groups.map((group) => DATA.groups.series[group])), missing: 0,
      columns: [...GROUP_COLUMNS, { label: "Sent again", unit: "times", format: formatCount }, { label: "Messages", unit: "messages", format: formatCount }, { label: `${label} p50`, unit: "ns", format: formatNs }, { label: `${label} max`, unit: "ns", format: formatNs }],
      rows: groups.flatMap((group) => plan.groups[group].map((point) => groupRow(group, point.repeats, point.messages, point.p50_ns, point.max_ns))),
    };
  },
});
