"use strict";
// Small multiples: panels side by side in as many columns as the page is wide.

function theme() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return {
    dark: document.documentElement.dataset.theme === "dark",
    ground: of("ground"),
    raised: of("raised"),
    ink: of("ink"),
    soft: of("soft"),
    line: of("line"),
    grid: of("grid"),
    error: of("error"),
    parts: [of("part-a"), of("part-b"), of("part-c"), of("part-d")],
  };
}

/** A colour mixed with the page's ground; 1 is the colour. */
function tinted(color, share = 1) {
  const parts = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  const ground = parts(theme().ground);
  return `rgb(${parts(color).map((part, at) => Math.round(share * part + (1 - share) * ground[at]))})`;
}

function axisStyle(colors) {
  return {
    gridcolor: colors.grid,
    linecolor: colors.line,
    zerolinecolor: colors.line,
    tickfont: { color: colors.soft, size: 12 },
    ticks: "",
    automargin: false,
    exponentformat: "none",
  };
}

/** Whether a figure is as narrow as on a phone: smaller panels, and names of lines only in the legend. */
const isNarrow = (width) => width < 600;

const MOST_PANELS = 24; // of one figure, until the reader asks for all
const PAGE_HEIGHT = 933; // px of the 247 mm that a page has room for
const LEAST_COLUMN = 96; // px of a panel in a labelled grid
const [LEAST_ROW, LEAST_TITLED] = [64, 100]; // px of a plot, and of one by itself, whose axis has its title
const [LETTER, BOLD] = [6.2, 7.5]; // px of a letter of 12 px
const END_STEP = 13; // px between two labels at line ends

/**
 * Panels {title, traces, x, y, height?, share?, shapes?, notes?, ends?} as one plotly figure. Panels of one `share`
 * have one y axis: side by side, only the first has labels at its ticks. `columns` panels are side by side if there is
 * room. `all` {page, height} is a picture: panels with labels are a grid whose rows and columns are labelled once, and
 * what is higher than `height` px or too narrow is on `pages`.
 */
function gridOf(
  panels,
  width,
  { minWidth = 300, height = 215, yTitle = "", left = 70, right = 16, below = 40, columns = 0, all = true } = {},
) {
  if (panels.some(({ y }) => y.startsAt)) left += 16; // px of the line that says so
  const colors = theme();
  const isPicture = all.page !== undefined;
  const every = all ? panels : panels.slice(0, MOST_PANELS);
  const grid = isPicture && panels.length > 1 && panels.every((panel) => panel.labels) ? labelledGrid(panels) : null;
  const inner = Math.max(160, width - left - right);
  const fit = (least, gap) => Math.max(1, Math.floor((inner + gap) / (least + gap)));
  const wideBy = (gap) => {
    const fits = Math.min(every.length, fit(minWidth, gap)) || 1;
    const rows = Math.ceil(every.length / fits);
    const beside =
      columns && columns <= fits
        ? columns * Math.max(1, Math.floor(fits / columns))
        : Math.ceil(every.length / rows) || 1;
    return Math.min(beside, every.length) || 1;
  };
  const shared = (wide, place) =>
    place % wide > 0 && every[place].share !== undefined && every[place].share === every[place - 1].share;
  // Close together if the panels of each row share their axis. How many are in a row must not follow from that: the
  // figure would change its height with the scale (on a log axis all panels share it, on a linear one those of a row).
  const close = grid ? grid.columns.length : wideBy(16);
  const gapX = grid ? grid.gap : every.every((_, place) => place % close === 0 || shared(close, place)) ? 16 : 58;
  const arranged = grid || every.every((panel) => panel.share !== undefined) ? close : wideBy(gapX);
  const wide = grid ? evenly(arranged, fit(Math.min(inner, Math.max(LEAST_COLUMN, 0.8 * minWidth)), gapX)) : arranged;
  const panelWidth = (inner - (wide - 1) * gapX) / wide;
  const heads = (grid?.columns || []).map((label) => wrapped(label, panelWidth / 7.4));
  const named = yTitle ? 20 : 0;
  const head = grid ? named + 6 + 15 * Math.max(...heads.map((lines) => lines.length)) : 0;
  const titles = every.map(({ title }) => wrapped(title, (panelWidth - 10) / BOLD));
  const lines = Math.max(1, ...titles.map((own) => own.length));
  const rowHeads = (grid?.rows || []).map((label) => wrapped(label, (width - 20) / BOLD));
  const rowLines = Math.max(1, ...rowHeads.map((own) => own.length));
  const gapTop = grid ? (grid.rows.some(Boolean) ? 10 + 15 * rowLines : 8) : 11 + 15 * lines;
  const titled = below > 40 ? 16 : 0; // px that the title of an axis takes; only the last row has one
  const between = gapTop + below - titled;
  const spotOf = (place) => grid?.spots[place] || { row: Math.floor(place / wide), column: place % wide };
  const own = (panel) => panel.height || Math.round((isNarrow(width) ? 0.8 : 1) * height);
  const rowCount = grid ? grid.rows.length : Math.ceil(every.length / wide);
  const tallest = isPicture ? all.height - head - titled : Infinity;
  const least = Math.max(...every.map((panel) => Math.min(own(panel), Math.max(LEAST_ROW, 0.6 * (panel.height || 0)))));
  const high = isPicture ? evenly(rowCount, Math.floor(tallest / (least + between))) : rowCount;
  const pagesBeside = Math.ceil(arranged / wide);
  const number = all.page || 0;
  const page = { row: high * Math.floor(number / pagesBeside), column: wide * (number % pagesBeside) };
  const shown = [];
  every.forEach((panel, place) => {
    const [row, column] = [spotOf(place).row - page.row, spotOf(place).column - page.column];
    if (row < 0 || row >= high || column < 0 || column >= wide) return;
    const shares = column > 0 && (grid ? grid.shares[place] : shared(wide, place));
    shown.push({ panel, row, column, shares, title: titles[place] });
  });
  const room = tallest / Math.max(1, Math.min(high, rowCount - page.row)) - between;
  const most = high > 1 ? room : Math.max(room, LEAST_TITLED);
  // Of the plots in each row, px.
  const heights = Array(Math.max(0, Math.min(high, rowCount - page.row))).fill(0);
  for (const { panel, row } of shown) heights[row] = Math.floor(Math.min(most, Math.max(heights[row], own(panel))));
  const starts = [head]; // of each row, px from the top
  heights.forEach((each, row) => starts.push(starts[row] + each + between + (row < heights.length - 1 ? 0 : titled)));
  const total = starts[starts.length - 1];
  const data = [],
    annotations = [],
    shapes = [];
  const layout = {
    width,
    height: total,
    margin: { l: left, r: right, t: 0, b: 0, pad: 0 },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, sans-serif", size: 12, color: colors.ink },
    showlegend: false,
    hovermode: "closest",
    dragmode: "zoom",
    annotations,
    shapes,
    hoverlabel: {
      bgcolor: colors.raised,
      bordercolor: colors.soft,
      font: { color: colors.ink, size: 12 },
      align: "left",
    },
  };
  const leaders = new Map(); // share -> the first axis of it
  shown.forEach(({ panel, row, column, shares, title }, place) => {
    const suffix = place === 0 ? "" : String(place + 1);
    const x0 = (column * (panelWidth + gapX)) / inner;
    const top = 1 - (starts[row] + gapTop) / total;
    const bottom = 1 - (starts[row] + gapTop + heights[row]) / total;
    const leader = panel.share === undefined ? undefined : leaders.get(panel.share);
    if (panel.share !== undefined && leader === undefined) leaders.set(panel.share, `y${suffix}`);
    const { startsAt, ...y } = panel.y;
    layout[`xaxis${suffix}`] = {
      ...axisStyle(colors),
      domain: [x0, x0 + panelWidth / inner],
      anchor: `y${suffix}`,
      ...panel.x(panelWidth),
    };
    if (row < heights.length - 1 && below > 40) layout[`xaxis${suffix}`].title = undefined;
    layout[`yaxis${suffix}`] = {
      ...axisStyle(colors),
      domain: [bottom, top],
      anchor: `x${suffix}`,
      ...(leader ? { matches: leader } : {}),
      ...y,
      ...(shares ? { showticklabels: false } : {}),
    };
    if (!grid && column === 0 && yTitle) {
      const fitting = plain(fitted(yTitle, heights[row] + (isPicture || isNarrow(width) ? 8 : between / 2)));
      const from = startsAt ? `${fitting}<br><b>axis starts at ${startsAt}</b>` : fitting;
      const place = { xref: "paper", x: 0, xshift: 6 - left, xanchor: "left", yref: "paper", y: (top + bottom) / 2 };
      const font = { size: 12, color: colors.soft };
      annotations.push({ ...place, text: from, textangle: -90, yanchor: "middle", showarrow: false, font });
    }
    if (!grid)
      annotations.push({
        text: `<b>${title.map(plain).join("<br>")}</b>`,
        align: "left",
        xref: "paper",
        yref: "paper",
        x: x0,
        y: top,
        yshift: 6,
        xanchor: "left",
        yanchor: "bottom",
        showarrow: false,
        font: { size: 12, color: colors.ink },
      });
    const lastOfRow = column === wide - 1 || place === shown.length - 1;
    if (lastOfRow && panel.ends?.length) annotations.push(...endLabels(panel, heights[row], suffix));
    if (panel.beside?.length)
      annotations.push(...markLabels(panel, layout[`xaxis${suffix}`], panelWidth, heights[row], suffix));
    for (const note of panel.notes || [])
      annotations.push({ ...note(panelWidth, colors), xref: `x${suffix}`, showarrow: false, yref: "paper", y: bottom });
    for (const shape of panel.shapes || [])
      shapes.push({ xref: `x${suffix}`, yref: `y${suffix} domain`, ...shape(colors, suffix) });
    const axes = { x: layout[`xaxis${suffix}`], y: layout[`yaxis${suffix}`] };
    for (const trace of panel.traces)
      data.push({ ...withinAxes(trace, axes), xaxis: `x${suffix}`, yaxis: `y${suffix}` });
  });
  if (grid) {
    const note = { xref: "paper", yref: "paper", showarrow: false, font: { size: 12, color: colors.ink } };
    const add = (text, x, px, more) => annotations.push({ ...note, text, x, y: 1 - px / total, ...more });
    heads.slice(page.column, page.column + wide).forEach((lines, column) => {
      const text = `<b>${lines.map(plain).join("<br>")}</b>`;
      add(text, (column * (panelWidth + gapX)) / inner, head, { xanchor: "left", yanchor: "bottom", align: "left" });
    });
    rowHeads.slice(page.row, page.row + high).forEach((own, row) => {
      const from = { xanchor: "left", yanchor: "bottom", xshift: -left + 8, align: "left" };
      if (own[0]) add(`<b>${own.map(plain).join("<br>")}</b>`, 0, starts[row] + gapTop - 2, from);
    });
    const soft = { xanchor: "left", yanchor: "bottom", xshift: 8 - left, font: { size: 12, color: colors.soft } };
    if (yTitle) add(plain(yTitle), 0, named, soft);
  }
  return {
    data,
    layout,
    panels: panels.length,
    shown: isPicture ? panels.length : shown.length,
    pages: pagesBeside * Math.ceil(rowCount / high),
    titles: every.map(({ title }, place) => ({ axis: place ? `yaxis${place + 1}` : "yaxis", title })),
  };
}

/** A trace whose error bars end at the edge of an axis that they would leave. */
function withinAxes(trace, axes) {
  const limited = { ...trace };
  for (const letter of ["x", "y"]) {
    const [bars, { range, type }] = [trace[`error_${letter}`], axes[letter]];
    if (!bars?.array || !range) continue;
    const [low, high] = type === "log" ? range.map((end) => 10 ** end) : range;
    const room = (lengths, of) =>
      lengths.map((length, at) => Math.max(0, Math.min(length, of(trace[letter][at] ?? Infinity))));
    limited[`error_${letter}`] = {
      ...bars,
      symmetric: false,
      array: room(bars.array, (value) => high - value),
      arrayminus: room(bars.arrayminus || bars.array, (value) => value - low),
    };
  }
  return limited;
}

/** How many of `count` are on each page if at most `most` fit. */
const evenly = (count, most) => Math.ceil(count / Math.ceil(count / Math.max(1, most))) || 1;

/** Rows and columns of panels by their labels, and which panels take their ticks from the one to the left. */
function labelledGrid(panels) {
  const [rows, columns] = ["row", "column"].map((key) => [...new Set(panels.map(({ labels }) => labels[key]))]);
  const spots = panels.map(({ labels }) => ({ row: rows.indexOf(labels.row), column: columns.indexOf(labels.column) }));
  const shares = panels.map(({ share }, place) =>
    panels.some(
      (other, at) =>
        spots[at].row === spots[place].row &&
        spots[at].column === spots[place].column - 1 &&
        share !== undefined &&
        other.share === share,
    ),
  );
  return { rows, columns, spots, shares, gap: spots.every(({ column }, place) => !column || shares[place]) ? 32 : 58 };
}

function wrapped(text, most) {
  const lines = [""];
  for (const part of text.match(/\S+?(-|\s|$)/g) || []) {
    const last = lines[lines.length - 1];
    if (last && last.length + part.trimEnd().length > most) lines.push(part);
    else lines[lines.length - 1] = last + part;
  }
  return lines;
}

/** What is written to the right of marks (left of those at the edge), pushed apart where marks are close. */
function markLabels({ beside, ends, y }, x, width, height, suffix) {
  const share = (axis, value) =>
    ((axis.type === "log" ? Math.log10(value) : value) - axis.range[0]) / (axis.range[1] - axis.range[0]);
  const ordered = beside
    .map((one) => ({ ...one, left: share(x, one.x) * width, at: share(y, one.y) * height }))
    .sort((a, b) => a.at - b.at);
  const long = ({ text }) => LETTER * text.length;
  const isEdge = (one) => one.left + long(one) > width + (ends?.length ? -6 : 6); // the lines' names begin there
  const start = (one) => one.left + (isEdge(one) ? -6 - long(one) : 6);
  const placed = [];
  for (const one of ordered) {
    for (const other of placed.sort((a, b) => a.at - b.at))
      if (Math.abs(start(other) - start(one)) < long(other) && one.at - other.at < END_STEP)
        one.at = other.at + END_STEP;
    placed.push(one);
  }
  placed.reverse().forEach((one, place) => {
    one.at = Math.min(one.at, height - 6);
    for (const other of placed.slice(0, place))
      if (Math.abs(start(other) - start(one)) < long(other) && other.at - one.at < END_STEP)
        one.at = other.at - END_STEP;
  });
  return placed.map((one) => {
    const edge = isEdge(one);
    return {
      text: plain(one.text),
      xref: `x${suffix} domain`,
      x: one.left / width,
      xshift: edge ? -6 : 6,
      xanchor: edge ? "right" : "left",
      yref: `y${suffix} domain`,
      y: one.at / height,
      yanchor: "middle",
      showarrow: false,
      font: { size: 12, color: one.color },
      bgcolor: theme().ground,
      borderpad: 0,
      opacity: 0.9,
    };
  });
}

/** The names of the lines of a panel at their ends, pushed apart where they would hide one another. */
function endLabels({ ends, y }, height, suffix) {
  const at = (value) => (y.type === "log" ? Math.log10(value) : value);
  const px = (value) => ((at(value) - y.range[0]) / (y.range[1] - y.range[0])) * height;
  const ordered = ends.map((end) => ({ ...end, px: px(end.y) })).sort((a, b) => a.px - b.px);
  ordered.forEach((end, place) => {
    end.at = place ? Math.max(end.px, ordered[place - 1].at + END_STEP) : Math.max(6, end.px);
  });
  const over = ordered[ordered.length - 1].at - (height - 4);
  if (over > 0)
    ordered.forEach((end, place) => {
      end.at = Math.min(end.at, height - 4 - END_STEP * (ordered.length - 1 - place));
    });
  return ordered.map((end) => ({
    text: plain(shorten(end.text, 23)),
    xref: `x${suffix} domain`,
    x: 1,
    xshift: 5,
    yref: `y${suffix} domain`,
    y: end.at / height,
    xanchor: "left",
    yanchor: "middle",
    showarrow: false,
    font: { size: 12, color: end.color },
  }));
}

/** The title of an axis without its remark, and shortened, where a panel is lower than it is long. */
function fitted(text, height) {
  const room = height / LETTER;
  return text.length > room ? shorten(text.replace(/ \(.*\)$/, ""), room) : text;
}

function shorten(text, most) {
  const room = Math.max(8, Math.floor(most));
  return text.length > room ? `${text.slice(0, room - 1)}…` : text;
}

/** Least width of panels: so many px for each position of the one with most. */
const widthFor = (panels, width, least, each) =>
  Math.min(width - 80, Math.max(least, each * Math.max(1, ...panels.map(({ weight }) => weight))));

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
      if (px - last >= room) {
        kept.push(place);
        last = px;
      }
    });
    return {
      type: log ? "log" : "linear",
      range: [
        at[0] - pad - (span === 1 && at.length === 1 ? 0.5 : 0),
        at[at.length - 1] + pad + (at.length === 1 ? 0.5 : 0),
      ],
      tickmode: "array",
      tickvals: kept.map((place) => positions[place]),
      ticktext: kept.map((place) => plain(labels[place])),
      tickangle: 0,
      title: axisTitle(title),
      zeroline: false,
    };
  };
}

/** A log axis of amounts of data per second, named at powers of ten (and three times those where it is short). */
function loadAxis(values, title = "") {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const first = Math.floor(Math.log10(low)) - 1;
  const powers = Array.from({ length: Math.ceil(Math.log10(high)) - first + 2 }, (_, step) => 10 ** (first + step));
  const inside = powers.filter((value) => value >= low / 1.5 && value <= high * 1.5);
  const near = powers
    .flatMap((value) => [value, 3 * value])
    .filter((value) => value >= low / 1.3 && value <= high * 1.3);
  const ticks = inside.length > 2 ? inside : near.length > 1 ? near : high > 1.3 * low ? [low, high] : [low];
  return {
    type: "log",
    tickmode: "array",
    tickvals: ticks,
    ticktext: ticks.map((value) => plain(formatBytesPerS(value))),
    zeroline: false,
    tickangle: 0,
    range: [Math.log10(low) - 0.12, Math.log10(high) + 0.12],
    title: axisTitle(title),
  };
}

/** An axis of counts from 0, named at whole numbers. */
function countAxis(counts, title) {
  const most = Math.max(1, ...counts);
  const tickvals = [...new Set(linearTicks(0, most, 6).map(Math.round))];
  const range = [-0.05 * most, 1.05 * most];
  return () => ({ type: "linear", title: axisTitle(title), zeroline: false, range, tickvals });
}

/** An axis of named options at 0, 1, 2 ...; upright where they have no room side by side. */
function optionAxis(labels, isUpright = false) {
  return () => ({
    type: "linear",
    range: [-0.5, labels.length - 0.5],
    tickmode: "array",
    tickvals: labels.map((_, place) => place),
    ticktext: labels.map((label) =>
      isUpright ? plain(label) : plain(label).replace(", ", "<br>").replace(" → ", " →<br>"),
    ),
    tickangle: isUpright ? -90 : 0,
    showgrid: false,
    zeroline: false,
  });
}

/** An axis of cells: rates as ticks, sizes under them, a line between sizes. Cells are at 0, 1, 2 ... */
function cellAxis(cells) {
  const sizes = [];
  cells.forEach((cell, place) => {
    const last = sizes[sizes.length - 1];
    if (last && last.size === cell.size && last.data === cell.data) last.end = place;
    else sizes.push({ size: cell.size, data: cell.data, start: place, end: place });
  });
  const x = (width) => {
    const step = Math.max(1, Math.ceil(20 / (width / cells.length)));
    const unit = width / cells.length > 54 ? " Hz" : "";
    const kept = cells
      .map((_, place) => place)
      .filter(
        (place) =>
          step === 1 ||
          sizes.some(
            (size) =>
              (place - size.start) % step === 0 &&
              place >= size.start &&
              place <= size.end &&
              (place === size.start || step < size.end - size.start),
          ),
      );
    return {
      type: "linear",
      range: [-0.6, cells.length - 0.4],
      tickmode: "array",
      tickvals: kept,
      ticktext: kept.map((place) => plain(cells[place].hz ? digits(cells[place].hz) + unit : "max")),
      tickangle: 0,
      showgrid: false,
      zeroline: false,
    };
  };
  const notes = sizes.map((size) => (width, colors) => ({
    text: plain(
      ((size.end - size.start + 1) * width) / cells.length < size.size.length * 8.3
        ? size.size.replace(/ .*/, "")
        : size.size,
    ),
    x: (size.start + size.end) / 2,
    xanchor: "center",
    yanchor: "top",
    yshift: -18,
    font: { size: 12, color: colors.ink },
  }));
  const shapes = sizes.slice(1).map((size) => (colors) => ({
    type: "line",
    x0: size.start - 0.5,
    x1: size.start - 0.5,
    y0: 0,
    y1: 1,
    line: { color: colors.line, width: 1 },
    layer: "below",
  }));
  return { x, notes, shapes };
}
