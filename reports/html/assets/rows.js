"use strict";
// A figure of several rows of panels is one plot a row: drawn when it is seen, and never cut by the end of a page.

/** The rows {data, layout} of a drawn figure, from the top; each keeps the names of its axes. */
function rowsOf({ data, layout }) {
  const axisKey = (name) => `${name[0]}axis${name.slice(1)}`;
  const axes = (letter) => Object.keys(layout).filter((key) => key.startsWith(`${letter}axis`));
  // Axes over one another on one x axis are one panel.
  const topOf = (key) =>
    Math.round(
      (1 -
        Math.max(
          ...axes("y")
            .filter((other) => layout[other].anchor === layout[key].anchor)
            .map((other) => layout[other].domain[1]),
        )) *
        layout.height,
    );
  const tops = [...new Set(axes("y").map(topOf))].sort((a, b) => a - b);
  if (tops.length < 2) return [{ data, layout }];
  const starts = tops.map((top) => top - tops[0]);
  const ranges = { ...commonRanges("x", data, layout), ...commonRanges("y", data, layout) };
  return tops.map((top, row) => {
    const start = starts[row],
      height = (row + 1 < tops.length ? starts[row + 1] : layout.height) - start;
    const moved = (y) => 1 - ((1 - y) * layout.height - start) / height;
    const kept = new Set(
      axes("y")
        .filter((key) => topOf(key) === top)
        .flatMap((key) => [key, axisKey(layout[key].anchor)]),
    );
    const isHere = ({ xref = "paper", yref = "paper", y = 0 }) => {
      const axis = [yref, xref].map((ref) => ref.split(" ")[0]).find((ref) => ref !== "paper");
      return axis ? kept.has(axisKey(axis)) : moved(y) >= 0 && moved(y) <= 1;
    };
    const placed = (one) => (one.yref === "paper" ? { ...one, y: moved(one.y) } : one);
    const own = { ...layout, height };
    for (const key of [...axes("x"), ...axes("y")]) {
      if (!kept.has(key)) {
        delete own[key];
        continue;
      }
      own[key] = { ...layout[key], ...(key[0] === "y" ? { domain: layout[key].domain.map(moved) } : {}) };
      if (ranges[key]) own[key].range = ranges[key];
      if (own[key].matches && !kept.has(axisKey(own[key].matches))) delete own[key].matches;
    }
    own.annotations = (layout.annotations || []).filter(isHere).map(placed);
    own.shapes = (layout.shapes || []).filter(isHere);
    return { data: data.filter((trace) => kept.has(axisKey(trace.yaxis || "y"))), layout: own };
  });
}

/** Axis -> range, of those that share one with another (`matches`) and were left to plotly, which sees single rows. */
function commonRanges(letter, data, layout) {
  const sets = new Map(); // leading axis -> axes
  for (const key of Object.keys(layout).filter((one) => one.startsWith(`${letter}axis`))) {
    const lead = layout[key].matches || key.replace("axis", "");
    sets.set(lead, [...(sets.get(lead) || []), key]);
  }
  const ranges = {};
  for (const keys of sets.values()) {
    if (keys.length < 2 || keys.some((key) => layout[key].range)) continue;
    const names = new Set(keys.map((key) => key.replace("axis", "")));
    const { type, rangemode } = layout[keys[0]];
    const values = data
      .filter((trace) => names.has(trace[`${letter}axis`] || letter))
      .flatMap((trace) => reached(trace, letter));
    const seen = values
      .filter((value) => Number.isFinite(value) && (type !== "log" || value > 0))
      .map((value) => (type === "log" ? Math.log10(value) : value));
    if (!seen.length) continue;
    let [low, high] = seen.reduce(
      ([least, most], value) => [Math.min(least, value), Math.max(most, value)],
      [Infinity, -Infinity],
    );
    const pad = 0.06 * (high - low || 1);
    [low, high] =
      rangemode === "tozero" && type !== "log"
        ? [Math.min(0, low - (low < 0 ? pad : 0)), Math.max(0, high + pad)]
        : [low - pad, high + pad];
    for (const key of keys) ranges[key] = [low, high];
  }
  return ranges;
}

/** Every value of a trace along an axis, with the ends of its error bars. */
function reached(trace, letter) {
  const values = trace[letter] || [];
  const bars = trace[`error_${letter}`];
  if (!bars) return values;
  return values.flatMap((value, place) => [
    value,
    value + (bars.array?.[place] || 0),
    value - ((bars.arrayminus || bars.array)?.[place] || 0),
  ]);
}
