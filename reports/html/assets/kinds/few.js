"use strict";
// A few groups in one chart.

KINDS.dots = function dots(plan, width) {
  const passing = plan.groups.filter(passes);
  const timed = passing.filter((group) => statisticOf(group) !== null);
  const phone = width < 600;
  const row = (group) => passing.length - 1 - passing.indexOf(group);
  const name = (group) => {
    const { label, size, hz } = cellOf(group);
    const parts = [
      phone && !varies("data") && hz ? `${size} at ${formatHz(hz)}` : label,
      DATA.dimensions.choice.options.length > 1 ? choiceLook(group).short : "",
      varies("place") ? labelIn("place", group) : "",
    ].filter(Boolean);
    const lines = phone ? [parts[0], parts.slice(1).join(", ")] : [parts.join(", ")];
    const fitting = lines.filter(Boolean).flatMap((line) => wrapped(line, phone ? 26 : 60));
    return fitting.map(plain).slice(0, 2).join("<br>");
  };
  const longest = Math.max(...passing.flatMap((group) => name(group).split("<br>")).map((line) => line.length));
  const left = Math.min(phone ? 180 : 390, 20 + 6.6 * longest);
  const rows = {
    type: "linear",
    range: [-0.6, passing.length - 0.4],
    tickmode: "array",
    tickvals: passing.map(row),
    ticktext: passing.map(name),
    zeroline: false,
  };
  const looks = [...new Set(passing.map((group) => optionOf("choice", group)))].sort((a, b) => a - b);
  const traces = looks
    .filter((option) => !isHidden("choice", option))
    .map((option) => {
      const points = timed
        .filter((group) => optionOf("choice", group) === option)
        .map((group) => ({ group, value: statisticOf(group) }));
      const trace = marks(lookOf("choice", option), points, {
        x: (point) => point.value * S,
        y: (point) => row(point.group),
        mode: "markers",
        size: 10,
        hover: (point) =>
          groupHover(
            point.group,
            `${statisticLabel()}: ${formatNs(point.value)}`,
            ...intervalHover(point.group),
            sampleHover(point.group),
          ),
      });
      const bars = INTERVALS()
        ? errorBars(points, (point) => point.value, (point) => intervalOf(point.group), 1 / S, trace.marker.color)
        : undefined;
      return bars ? { ...trace, error_x: bars } : trace;
    });
  const shares = {
    type: "bar",
    orientation: "h",
    x: passing.map((group) => 100 * shareOf(group)),
    y: passing.map(row),
    width: 0.5,
    text: passing.map((group) => formatRatio(shareOf(group))),
    textposition: "inside",
    insidetextanchor: "start",
    constraintext: "none",
    textfont: { size: 12, color: theme().ink },
    marker: {
      color: passing.map((group) => (isLossy(group) ? theme().error : theme().grid)),
      opacity: passing.map((group) => (isLossy(group) ? 0.5 : 1)),
    },
    customdata: passing,
    hoverinfo: "text",
    hovertext: passing.map((group) => groupHover(group, sampleHover(group))),
  };
  const height = 30 + (passing.some((group) => name(group).includes("<br>")) ? 34 : 24) * passing.length;
  const values = timed.flatMap((group) => [statisticOf(group), ...intervalOf(group)]);
  const axis = timeAxis(values);
  // For what a bridge costs, in words right of the marks.
  const words = !phone && Object.keys(plan.cells).length ? Math.min(0.5, (27 * LETTER) / (0.82 * (width - left))) : 0;
  const range = [axis.range[0], axis.range[1] + ((axis.range[1] - axis.range[0]) * words) / (1 - words)];
  const x = {
    ...axis,
    range,
    ...timeTicks(range, axis.type === "log", Math.max(2, Math.min(6, Math.floor((width - left) / (phone ? 38 : 75))))),
    title: axisTitle(view.scale === "log" ? "log scale" : ""),
  };
  if (phone) x.ticktext = x.ticktext.map((text, at) => (at % 2 ? `<br>${text}` : text)); // in two rows
  const panels = [{ title: statisticLabel(), traces, x: () => x, y: rows, height }];
  const drawn = gridOf(timed.length ? panels : [], width, { left, below: phone ? 60 : 46 });
  if (timed.length && !phone) {
    // Beside the times, on the rows' own axis.
    drawn.layout.xaxis.domain = [0, 0.82];
    drawn.layout.xaxis2 = {
      ...axisStyle(theme()),
      domain: [0.86, 1],
      anchor: "y",
      range: [0, 100],
      showticklabels: false,
      showgrid: false,
      zeroline: false,
    };
    drawn.data.push({ ...shares, xaxis: "x2", yaxis: "y" });
    const title = drawn.layout.annotations[0];
    drawn.layout.annotations.push({ ...title, text: "<b>Received</b>", x: 1, xanchor: "right" });
    for (const group of passing) {
      const cost = plan.cells[group]?.costs[view.statistic];
      if (cost?.ratio)
        drawn.layout.annotations.push({
          ...title,
          xref: "paper",
          text: `×${digits(cost.ratio)} of the same domain`,
          x: 0.82,
          xanchor: "right",
          yref: "y",
          y: row(group),
          yshift: 0,
          yanchor: "middle",
          font: { size: 12, color: theme().soft },
        });
    }
  }
  return {
    ...drawn,
    legend: { dimension: "choice", options: looks },
    missing: passing.length - timed.length,
    foot: timed.some(isLossy) ? LOST_FOOT : "",
    columns: [
      ...GROUP_COLUMNS,
      { label: statisticLabel(), unit: "ns", format: formatNs },
      ...intervalColumns(),
      { label: "Received of planned", unit: "ratio", format: formatRatio },
    ],
    rows: passing.map((group) => groupRow(group, statisticOf(group), ...intervalCells(group), shareOf(group))),
  };
};
