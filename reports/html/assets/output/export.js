"use strict";
// Downloads: a figure as SVG or PNG, its numbers as CSV. Files are made in the page; nothing is sent.

/** One CSV field that no spreadsheet takes for a formula: a leading ' keeps such text text. */
function csvField(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return String(value);
  const text = /^[\s]*[=+\-@\t\r]/.test(value) ? `'${value}` : value;
  return `"${text.replace(/"/g, '""')}"`;
}

function csvOf(columns, rows) {
  const head = columns.map((column) => csvField(column.unit ? `${column.label} (${column.unit})` : column.label));
  return [head, ...rows.map((row) => columns.map((_, place) => csvField(row[place])))].map((fields) => fields.join(",")).join("\r\n") + "\r\n";
}

function saveAs(name, address) {
  const link = element("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
}

function saveCsv(name, columns, rows) {
  const address = URL.createObjectURL(new Blob(["\ufeff", csvOf(columns, rows)], { type: "text/csv;charset=utf-8" }));
  saveAs(`${name}.csv`, address);
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

/** The plot as it is seen, with its title, a legend and a ground of its own. */
async function savePicture(name, title, drawn, format) {
  const colors = theme();
  const seen = new Set();
  const data = drawn.data.map((trace) => {
    const named = trace.name && trace.type !== "heatmap" && !seen.has(trace.name);
    seen.add(trace.name);
    return { ...trace, showlegend: Boolean(named), legendgroup: trace.name };
  });
  const layout = {
    ...drawn.layout, paper_bgcolor: colors.ground, plot_bgcolor: colors.ground, showlegend: seen.size > 1,
    height: drawn.layout.height + 70, margin: { ...drawn.layout.margin, t: 70 },
    title: { text: plain(title), x: 0, xref: "paper", y: 1, yref: "container", yanchor: "top", pad: { t: 12 }, font: { size: 16 } },
    legend: { orientation: "h", x: 0, y: 1, yref: "container", yanchor: "top", xanchor: "left", font: { size: 11 } },
  };
  layout.legend = { ...layout.legend, y: 1 - 36 / layout.height };
  const address = await Plotly.toImage({ data, layout }, { format, width: layout.width, height: layout.height, scale: format === "png" ? 2 : 1 });
  saveAs(`${name}.${format}`, address);
}
