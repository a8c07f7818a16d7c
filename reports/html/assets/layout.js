"use strict";
// Small multiples: panels side by side in as many columns as the page is wide.

function theme() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return {
    dark: document.documentElement.dataset.theme === "dark",
    ground: of("ground"), raised: of("raised"), ink: of("ink"), soft: of("soft"), line: of("line"), grid: of("grid"),
    parts: [of("part-a"), of("part-b"), of("part-c"), of("part-d")],
  };
}

function seriesColor(series) { return theme().dark ? series.dark : series.light; }

function axisStyle(colors) {
  return {
    gridcolor: colors.grid, linecolor: colors.line, zerolinecolor: colors.line, tickfont: { color: colors.soft, size: 11 },
    ticks: "", automargin: false, exponentformat: "none",
  };
}

/** Panels {title, traces, x, y, height?, share?, shapes?, notes?} as one plotly figure; those of one `share` have one y range. */
function gridOf(panels, width, { minWidth = 300, height = 215, yTitle = "", right = 16, below = 40 } = {}) {
  const colors = theme();
  const left = 62, gapX = 58, gapTop = 30, gapBelow = below;
  const inner = Math.max(160, width - left - right);
  const columns = Math.max(1, Math.min(panels.length, Math.floor((inner + gapX) / (minWidth + gapX))));
  const panelWidth = (inner - (columns - 1) * gapX) / columns;
  const heights = [];   // of the plots in each row, px
  panels.forEach((panel, place) => { const row = Math.floor(place / columns); heights[row] = Math.max(heights[row] || 0, panel.height || height); });
  const starts = [0];   // of each row, px from the top
  for (const each of heights) starts.push(starts[starts.length - 1] + each + gapTop + gapBelow);
  const total = starts[starts.length - 1];
  const leaders = new Map();   // share -> the first axis of it
  const data = [], annotations = [], shapes = [];
  const layout = {
    width, height: total, margin: { l: left, r: right, t: 0, b: 0, pad: 0 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, sans-serif", size: 12, color: colors.ink },
    showlegend: false, hovermode: "closest", dragmode: "zoom", annotations, shapes,
    hoverlabel: { bgcolor: colors.raised, bordercolor: colors.soft, font: { color: colors.ink, size: 12 }, align: "left" },
  };
  panels.forEach((panel, place) => {
    const suffix = place === 0 ? "" : String(place + 1);
    const column = place % columns, row = Math.floor(place / columns);
    const x0 = (column * (panelWidth + gapX)) / inner;
    const top = 1 - (starts[row] + gapTop) / total;
    const bottom = 1 - (starts[row] + gapTop + heights[row]) / total;
    const leader = panel.share === undefined ? undefined : leaders.get(panel.share);
    if (panel.share !== undefined && leader === undefined) leaders.set(panel.share, `y${suffix}`);
    layout[`xaxis${suffix}`] = { ...axisStyle(colors), domain: [x0, x0 + panelWidth / inner], anchor: `y${suffix}`, ...panel.x(panelWidth) };
    layout[`yaxis${suffix}`] = {
      ...axisStyle(colors), domain: [bottom, top], anchor: `x${suffix}`,
      ...(leader ? { matches: leader } : {}), ...panel.y,
    };
    if (column === 0 && yTitle) {
      layout[`yaxis${suffix}`].title = { text: plain(yTitle), font: { size: 11, color: colors.soft }, standoff: 6 };
    }
    annotations.push({
      text: `<b>${plain(shorten(panel.title, panelWidth / 6.6))}</b>`, xref: "paper", yref: "paper", x: x0, y: top, yshift: 6,
      xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12.5, color: colors.ink },
    });
    for (const note of panel.notes || []) annotations.push({ ...note(panelWidth, colors), xref: `x${suffix}`, showarrow: false, yref: "paper", y: bottom });
    for (const shape of panel.shapes || []) shapes.push({ ...shape(colors), xref: `x${suffix}`, yref: `y${suffix} domain` });
    for (const trace of panel.traces) data.push({ ...trace, xaxis: `x${suffix}`, yaxis: `y${suffix}` });
  });
  return { data, layout };
}

function shorten(text, most) {
  const room = Math.max(8, Math.floor(most));
  return text.length > room ? `${text.slice(0, room - 1)}…` : text;
}

/** An axis that names only measured positions, as many as have room. `room` is the px that one label takes. */
function tickedAxis(positions, labels, { log = true, room = 34, title = "" } = {}) {
  return (width) => {
    const at = log ? positions.map(Math.log10) : positions;
    const span = Math.max(...at) - Math.min(...at) || 1;
    const pad = 0.06 * span;
    const kept = [];
    let last = -Infinity;
    at.forEach((where, place) => {
      const px = ((where - at[0]) / (span + 2 * pad)) * width;
      if (px - last >= room) { kept.push(place); last = px; }
    });
    return {
      type: log ? "log" : "linear", range: [at[0] - pad - (span === 1 && at.length === 1 ? 0.5 : 0), at[at.length - 1] + pad + (at.length === 1 ? 0.5 : 0)],
      tickmode: "array", tickvals: kept.map((place) => positions[place]), ticktext: kept.map((place) => plain(labels[place])),
      tickangle: 0, title: { text: plain(title), font: { size: 11, color: theme().soft }, standoff: 4 }, zeroline: false,
    };
  };
}

/** A log axis of amounts of data per second, named at powers of ten (and three times those where it is short). */
function loadAxis(values, title = "") {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const first = Math.floor(Math.log10(low)) - 1;
  const powers = Array.from({ length: Math.ceil(Math.log10(high)) - first + 2 }, (_, step) => 10 ** (first + step));
  const inside = powers.filter((value) => value >= low / 1.5 && value <= high * 1.5);
  const near = powers.flatMap((value) => [value, 3 * value]).filter((value) => value >= low / 1.3 && value <= high * 1.3);
  const ticks = inside.length > 2 ? inside : near.length > 1 ? near : [...new Set([low, high])];
  return {
    type: "log", tickmode: "array", tickvals: ticks, ticktext: ticks.map((value) => plain(formatBytesPerS(value))), zeroline: false, tickangle: 0,
    range: [Math.log10(low) - 0.12, Math.log10(high) + 0.12], title: { text: plain(title), font: { size: 11, color: theme().soft }, standoff: 4 },
  };
}

/** An axis of cells: rates as ticks, sizes under them, a line between sizes. Cells stand at 0, 1, 2 ... */
function cellAxis(cells) {
  const sizes = [];
  cells.forEach((cell, place) => {
    const last = sizes[sizes.length - 1];
    if (last && last.size === cell.size && last.data === cell.data) last.end = place;
    else sizes.push({ size: cell.size, data: cell.data, start: place, end: place });
  });
  const x = (width) => {
    const step = Math.max(1, Math.ceil(20 / (width / cells.length)));
    const kept = cells.map((_, place) => place).filter((place) => step === 1 || sizes.some((size) => (place - size.start) % step === 0 && place >= size.start && place <= size.end && (place === size.start || step < size.end - size.start)));
    return {
      type: "linear", range: [-0.6, cells.length - 0.4], tickmode: "array", tickvals: kept,
      ticktext: kept.map((place) => plain(digits(cells[place].hz))), tickangle: 0, showgrid: false, zeroline: false,
    };
  };
  const notes = sizes.map((size) => (width, colors) => ({
    text: plain(((size.end - size.start + 1) * width) / cells.length < size.size.length * 6.4 ? size.size.replace(/ .*/, "") : size.size),
    x: (size.start + size.end) / 2, xanchor: "center", yanchor: "top", yshift: -18, font: { size: 11, color: colors.ink },
  }));
  const shapes = sizes.slice(1).map((size) => (colors) => ({
    type: "line", x0: size.start - 0.5, x1: size.start - 0.5, y0: 0, y1: 1, line: { color: colors.line, width: 1 }, layer: "below",
  }));
  return { x, notes, shapes };
}
