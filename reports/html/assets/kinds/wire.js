"use strict";
// Figures about the wire.

// Colour and filling of each part of a message's cost; only what is left over is in a tint.
const WIRE_LOOKS = { data: [1], again: [0], control: [2], discovery: [3], other: [3, 0.3] };

Object.assign(KINDS, {
  wire_cost(plan, width, all) {
    const names = Object.keys(plan.names);
    const partOf = (group, name) => plan.parts[group].find((part) => part.name === name) || null;
    const found = collected(
      plan,
      (group) => (plan.parts[group] || []).reduce((sum, part) => sum + part.ratio, 0) || null,
    );
    const hover = (point) =>
      groupHover(
        point.group,
        `${digits(point.value)} bytes per payload byte`,
        ...plan.parts[point.group].map(
          (part) => `${plan.names[part.name]}: ${digits(part.ratio)} (${formatRatio(part.share)})`,
        ),
      );
    const drawn = stacked(plan, width, all, {
      found,
      names,
      looks: WIRE_LOOKS,
      valueOf: (group, name) => partOf(group, name)?.ratio ?? null,
      hover,
      yTitle: "Bytes per payload byte",
      y: { type: "linear", range: [0, 1.05 * Math.max(...found.points.map((point) => point.value))], nticks: 5 },
    });
    const low = found.points.filter((point) => plan.incomplete.includes(point.group)).length;
    return {
      ...drawn,
      foot:
        drawn.foot + (low ? ` The kernel dropped packets of ${counted(low, "result")}, whose bars are too low.` : ""),
      columns: [
        ...GROUP_COLUMNS,
        { label: "Bytes per payload byte", unit: "ratio", format: digits },
        ...names.map((name) => ({ label: plan.names[name], unit: "share of bytes", format: formatRatio })),
      ],
      rows: found.points.map(({ group, value }) =>
        groupRow(group, value, ...names.map((name) => partOf(group, name)?.share ?? null)),
      ),
    };
  },

  sent_again(plan, width, all) {
    const inCell = cellGroups().filter((group) => plan.groups[group]);
    const groups = seenInCell(inCell);
    const label = plan.metric === "latency" ? "Latency" : "Round trip";
    const timed = (group) => plan.groups[group].filter((point) => point.p50_ns !== null);
    const panel = {
      title: cellTitle(),
      traces: groups.map((group) => {
        const points = timed(group).map((point) => ({ ...point, group }));
        const trace = marks(choiceLook(group), points, {
          x: (point) => point.repeats,
          y: (point) => point.p50_ns * S,
          size: 8,
          hover: (point) =>
            groupHover(
              group,
              `sent again ${counted(point.repeats, "time")}: ${counted(point.messages, "message")}`,
              `${label} p50: ${formatNs(point.p50_ns)}, max: ${formatNs(point.max_ns)}`,
            ),
        });
        const ends = ({ p50_ns: median, max_ns: most }) => [median, most];
        trace.error_y = errorBars(points, (point) => point.p50_ns, ends, 1 / S, trace.marker.color);
        return trace;
      }),
      x: countAxis(
        groups.flatMap((group) => timed(group).map((point) => point.repeats)),
        "Sent again, times",
      ),
      y: timeAxis(groups.flatMap((group) => timed(group).flatMap((point) => [point.p50_ns, point.max_ns]))),
    };
    return {
      ...gridOf(groups.length ? [panel] : [], width, { yTitle: timeTitle(label), height: 190, below: 46, all }),
      legend: choicesOf(inCell),
      missing: 0,
      columns: [
        ...GROUP_COLUMNS,
        { label: "Sent again", unit: "times", format: formatCount },
        { label: "Messages", unit: "messages", format: formatCount },
        { label: `${label} p50`, unit: "ns", format: formatNs },
        { label: `${label} max`, unit: "ns", format: formatNs },
      ],
      rows: groups.flatMap((group) =>
        plan.groups[group].map((point) => groupRow(group, point.repeats, point.messages, point.p50_ns, point.max_ns)),
      ),
    };
  },
});
