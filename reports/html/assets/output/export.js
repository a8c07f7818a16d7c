"use strict";
// Downloads: figures as SVG and PNG in the widths of print, numbers as CSV and Parquet; PDF is the browser's own print.
// Files are made in the page; nothing is sent.

/** One CSV field that no spreadsheet takes for a formula: a leading ' keeps such text text. */
function csvField(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return String(value);
  const text = /^[\s]*[=+\-@\t\r]/.test(value) ? `'${value}` : value;
  return `"${text.replace(/"/g, '""')}"`;
}

function csvOf(columns, rows) {
  const head = columns.map((column) => csvField(column.unit ? `${column.label} (${column.unit})` : column.label));
  return (
    [head, ...rows.map((row) => columns.map((_, place) => csvField(row[place])))]
      .map((fields) => fields.join(","))
      .join("\r\n") + "\r\n"
  );
}

function saveAs(name, address) {
  const link = element("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
}

function saveBlob(name, blob) {
  const address = URL.createObjectURL(blob);
  saveAs(name, address);
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

function saveCsv(name, columns, rows) {
  saveBlob(`${name}.csv`, new Blob(["\ufeff", csvOf(columns, rows)], { type: "text/csv;charset=utf-8" }));
}

const PX_PER_MM = 96 / 25.4;
const EDGE = 8; // px around the plots, for labels that reach over their axis
const SYMBOL = 44; // px of a name's symbol in the legend
const LEGEND_SHARE = 0.19; // of a picture's height: plots grow where the legend has more, up to a page
const PNG_SCALE = 600 / 96; // 600 dots an inch where the width is one of print
const isColumn = (mm) => mm !== null && mm < 100;
const tallest = (mm) => (isColumn(mm) ? 454 : PAGE_HEIGHT); // px; 120 mm in a column, where its legend is no longer

/** What journals print: one column or two; `null` is the width on the screen. */
const PICTURE_WIDTHS = [
  { key: "screen", label: "as wide as here", mm: null },
  { key: "column", label: "84 mm", mm: 84 },
  { key: "page", label: "174 mm", mm: 174 },
];

function chosenWidth() {
  const select = document.getElementById("save-width");
  return PICTURE_WIDTHS.find((one) => one.key === select?.value) || PICTURE_WIDTHS[0];
}

/** A figure, or one panel, for paper: on white, in light colours, of the chosen width; several if it is too high. */
function picturesOf(block, panel = "", { mm = chosenWidth().mm, title = block.title(), below = 0 } = {}) {
  const root = document.documentElement;
  const before = root.dataset.theme;
  const width = mm === null ? block.drawn.layout.width : Math.round(mm * PX_PER_MM);
  root.dataset.theme = "light"; // for as long as the colours are read: nothing is painted in between
  try {
    const draw = (all) => KINDS[block.figure.kind](block.figure.plan, width, all);
    if (panel) return [onWhite(panelOf(draw(true), panel, width), title, width, mm)];
    const whole = draw(true);
    const { above, legend } = headOf(whole, title && `${title} (9 of 9)`, width, mm);
    const height = Math.max(tallest(mm), Math.min(PAGE_HEIGHT, legend / LEGEND_SHARE)) - below - above - EDGE;
    const first = draw({ page: 0, height });
    const drawn = [first, ...Array.from({ length: first.pages - 1 }, (_, at) => draw({ page: at + 1, height }))];
    const shown = drawn.filter(({ data }) => data.length);
    const named = (at) => (title && shown.length > 1 ? `${title} (${at + 1} of ${shown.length})` : title);
    return shown.map((one, at) => onWhite(one, named(at), width, mm));
  } finally {
    root.dataset.theme = before;
  }
}

/** One panel of a figure as a figure. */
function panelOf({ data, layout, titles }, axis, width) {
  const x = layout[axis].anchor;
  // over one another
  const over = Object.keys(layout).filter((key) => key.startsWith("yaxis") && layout[key].anchor === x);
  const names = over.map((key) => key.replace("axis", ""));
  const [bottom, top] = [
    Math.min(...over.map((key) => layout[key].domain[0])),
    Math.max(...over.map((key) => layout[key].domain[1])),
  ];
  const ranges = commonRanges("y", data, layout);
  const height = (top - bottom) * layout.height;
  const belongs = ({ xref = "", yref = "" }) => [xref, yref].some((ref) => [x, ...names].includes(ref.split(" ")[0]));
  const kept = Object.fromEntries(Object.entries(layout).filter(([key]) => !/^[xy]axis/.test(key)));
  const annotations = (layout.annotations || [])
    .filter(belongs)
    .map((note) => (note.yref === "paper" ? { ...note, y: 0 } : note));
  return {
    data: data.filter((trace) => names.includes(trace.yaxis || "y")),
    layout: {
      ...kept,
      width,
      height: height + 76,
      margin: { ...layout.margin, t: 26, b: 50 },
      annotations,
      shapes: (layout.shapes || []).filter(belongs),
      ...Object.fromEntries(
        over.map((key) => [
          key,
          {
            ...layout[key],
            ...(ranges[key] ? { range: ranges[key] } : {}),
            matches: undefined,
            showticklabels: true,
            domain: layout[key].domain.map((end) => (end - bottom) / (top - bottom)),
          },
        ]),
      ),
      [x.replace("x", "xaxis")]: { ...layout[x.replace("x", "xaxis")], matches: undefined, domain: [0, 1] },
      title: { text: titles.find((one) => one.axis === axis)?.title || "" },
    },
  };
}

/** What is above a picture's plots: its title in lines, and room for the legend. */
function headOf({ data, layout }, title, width, mm) {
  const size = isColumn(mm) ? 10 : 11;
  const short = (name) => (isColumn(mm) ? name.replace(/ \((to )?T\d.*\)$/, "") : name);
  const named = data.filter(({ name, type }) => name && type !== "heatmap");
  const names = [...new Set(named.map(({ name }) => short(name)))];
  const longest = SYMBOL + Math.max(0, ...names.map(({ length }) => length)) * size * 0.56;
  const columns = Math.max(1, Math.floor((width - 4 * EDGE) / longest));
  const text = [title, layout.title?.text].filter(Boolean).join(": ");
  const head = text ? wrapped(text, (width - 20) / (size * 0.68)) : [];
  const titled = 14 + head.length * (size + 5);
  const entry = Math.floor((width - 4 * EDGE) / columns) - SYMBOL;
  const fit = (name) => wrapped(short(name), entry / (size * 0.56)).map((line) => line.trim());
  const lines = names.reduce((sum, name) => sum + fit(name).length - 1, Math.ceil(names.length / columns));
  const legend = names.length > 1 ? lines * (size + 9) + 6 : 0;
  return { size, head, legend, fit, entry, above: titled + legend };
}

/** The figure with title and legend of its own on white ground; room for both is made above it. */
function onWhite(drawn, title, width, mm) {
  const { data, layout } = drawn;
  const { size, head, legend, fit, entry, above } = headOf(drawn, title, width, mm);
  const seen = new Set();
  const traces = data.map((trace) => {
    const named = trace.name && trace.type !== "heatmap" && !seen.has(trace.name);
    if (trace.name) seen.add(trace.name);
    const name = trace.name && fit(trace.name).join("<br>");
    return { ...trace, name, showlegend: Boolean(named), legendgroup: undefined };
  });
  for (const [at, tiles] of traces.filter(({ type }) => type === "heatmap").entries()) tiles.showscale = at === 0;
  const margin = { ...layout.margin, b: layout.margin.b + EDGE, l: layout.margin.l + EDGE, r: layout.margin.r + EDGE };
  const drawnHeight = layout.height + above + EDGE;
  const height = Math.round(Math.max(drawnHeight, Math.min(PAGE_HEIGHT, legend / LEGEND_SHARE)));
  return {
    data: traces,
    layout: {
      ...layout,
      width,
      height,
      font: { ...layout.font, family: "Helvetica, Arial, sans-serif" },
      paper_bgcolor: "#ffffff",
      plot_bgcolor: "#ffffff",
      showlegend: legend > 0,
      margin: { ...margin, t: layout.margin.t + above },
      title: {
        text: head.map(plain).join("<br>"),
        x: 0,
        xref: "container",
        y: 1,
        yref: "container",
        yanchor: "top",
        pad: { t: 12, l: 8 },
        font: { size: size + 2, color: layout.font.color },
      },
      legend: {
        orientation: "h",
        x: -margin.l / (width - margin.l - margin.r),
        xanchor: "left",
        y: 1,
        yanchor: "bottom",
        font: { size },
        entrywidth: entry,
      },
    },
    mm,
    foot: drawn.foot,
  };
}

/** The picture as SVG, whose size is in mm where the width is one of print. */
async function svgOf({ data, layout, mm }) {
  const address = await Plotly.toImage({ data, layout }, { format: "svg", width: layout.width, height: layout.height });
  const text = decodeURIComponent(address.slice(address.indexOf(",") + 1));
  return mm === null
    ? text
    : text.replace(
        /width="[^"]*" height="[^"]*"/,
        `width="${mm}mm" height="${(layout.height / PX_PER_MM).toFixed(2)}mm"`,
      );
}

async function savePicture(name, block, format) {
  await savePictures(name, format, [[name, picturesOf(block, block.article.querySelector("[data-panel]")?.value)]]);
}

/** Saves [name, pictures] of figures as one file, a zip where there are several; as PDF each is a page of its size. */
async function savePictures(name, format, figures, options) {
  if (format === "pdf") {
    const pictures = figures.flatMap(([, own]) => own);
    const sizeOf = ({ width, height }) => `${width}px ${Math.ceil(height) + 1}px; margin: 0`;
    const sheets = pictures.map((picture) => ({ picture, size: sizeOf(picture.layout), words: [] }));
    return printSheets(name, sheets, options);
  }
  const files = figures.flatMap(([own, pictures]) =>
    pictures.map((picture, at) => ({ name: `${own}${pictures.length > 1 ? `-${at + 1}` : ""}.${format}`, picture })),
  );
  if (files.length === 1) return saveBlob(files[0].name, await pictureBlob(files[0].picture, format));
  for (const file of files)
    file.content = new Uint8Array(await (await pictureBlob(file.picture, format)).arrayBuffer());
  saveBlob(`${name}-${format}.zip`, new Blob(zipParts(files), { type: "application/zip" }));
}

/** Prints pages {picture, size, words} in place of the page: vectors, with their fonts in the file. */
async function printSheets(name, pages, { dialog = true } = {}) {
  document.getElementById("sheets")?.remove(); // where a browser never said that it has printed
  const sheets = document.body.appendChild(element("div", { id: "sheets" }));
  const title = document.title;
  for (const [at, { picture, size, words }] of pages.entries()) {
    const svg = new DOMParser().parseFromString(await svgOf(picture), "image/svg+xml").documentElement;
    const style = element("style", {}, `@page sheet-${at} { size: ${size}; }`);
    const lines = words.map((text) => element("p", {}, text));
    const sheet = element("div", { class: "sheet", style: `page: sheet-${at}` }, document.adoptNode(svg), ...lines);
    sheets.append(style, sheet);
  }
  if (!dialog) return;
  const leave = () => {
    document.title = title;
    sheets.remove();
  };
  addEventListener("afterprint", leave, { once: true });
  document.title = name; // what the dialog proposes for the file
  print();
}

async function pictureBlob(picture, format) {
  if (format === "svg") return new Blob([await svgOf(picture)], { type: "image/svg+xml" });
  const { width, height } = picture.layout;
  const scale = picture.mm === null ? 2 : PNG_SCALE;
  const address = await Plotly.toImage(picture, { format: "png", width, height, scale });
  const bytes = Uint8Array.from(atob(address.slice(address.indexOf(",") + 1)), (character) => character.charCodeAt(0));
  return new Blob([bytes], { type: "image/png" });
}

function crc32(bytes) {
  let crc = -1;
  for (const byte of bytes) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit += 1) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return ~crc >>> 0;
}

/** A zip of stored files {name, content}, dated 1980-01-01. */
function zipParts(files) {
  const fields = (...pairs) => {
    const view = new DataView(new ArrayBuffer(pairs.reduce((sum, [size]) => sum + size, 0)));
    pairs.reduce((at, [size, value]) => {
      if (size === 2) view.setUint16(at, value, true);
      else view.setUint32(at, value, true);
      return at + size;
    }, 0);
    return view;
  };
  const parts = [],
    directory = [];
  let offset = 0,
    listed = 0;
  for (const { name, content } of files) {
    const encoded = new TextEncoder().encode(name);
    const size = content.length;
    // prettier-ignore
    const common = [[2, 20], [2, 0x800], [2, 0], [2, 0], [2, 0x21], [4, crc32(content)], [4, size], [4, size]];
    common.push([2, encoded.length], [2, 0]);
    parts.push(fields([4, 0x04034b50], ...common), encoded, content);
    directory.push(fields([4, 0x02014b50], [2, 20], ...common, [2, 0], [2, 0], [2, 0], [4, 0], [4, offset]), encoded);
    offset += 30 + encoded.length + size;
    listed += 46 + encoded.length;
  }
  const count = files.length;
  // prettier-ignore
  const end = fields([4, 0x06054b50], [2, 0], [2, 0], [2, count], [2, count], [4, listed], [4, offset], [2, 0]);
  return [...parts, ...directory, end];
}

/** Every figure of the page in one zip; as PDF one page each, without a dialog where a program prints the page. */
async function saveAll(format, options) {
  const { mm } = { ...chosenWidth(), ...options };
  const [column, star] = isColumn(mm) ? ["-column", ""] : ["", "*"]; // figure* is as wide as both columns
  const name = `figures${column}`;
  for (const block of blocks) block.plan();
  const drawn = blocks.filter((block) => block.drawn.data.length);
  const figures = drawn.map((block) => [block.fileName(), picturesOf(block, "", options)]);
  if (format !== "tex") return savePictures(name, format, figures, options);
  let page = 0;
  const latex = ([label, pictures], at) =>
    pictures.map(
      (_, part) => `
\\begin{figure${star}}
  \\includegraphics[width=${mm ? `${mm}mm` : "\\textwidth"},page=${(page += 1)}]{${name}.pdf}
  \\caption{${latexOf(captionOf(drawn[at], pictures))}}
  \\label{fig:${label}${column}${part ? `-${part + 1}` : ""}}
\\end{figure${star}}
`,
    );
  const elsewhere = "if it is in another folder: \\graphicspath{{FOLDER/}}";
  const head = `% Needs graphicx and ${name}.pdf; ${elsewhere}\n% ${measuredWith()}\n`;
  const text = [head, ...figures.flatMap(latex)].join("");
  if (options) return document.body.append(element("pre", { id: "latex", hidden: "" }, text)); // for who prints it
  saveBlob(`${name}.tex`, new Blob([text], { type: "application/x-tex" }));
}

/** What LaTeX would take for commands, escaped; signs that its fonts lack are in its mathematics. */
const LATEX_SIGNS = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}" };
const LATEX_MATHS = { "→": "to", "≤": "le", "≥": "ge", "≈": "approx" };
const latexOf = (text) =>
  text
    .replace(/[\\~^%_&#${}]/g, (sign) => LATEX_SIGNS[sign] || `\\${sign}`)
    .replace(/[→≤≥≈]/g, (sign) => `$\\${LATEX_MATHS[sign]}$`);

/** What pictures of a figure show, of how many messages and runs, with which intervals, and under which conditions. */
function captionOf(block, [{ foot = "" }]) {
  const ofCell = block.article.closest("#cell");
  const groups = ofCell ? seenInCell(cellGroups()) : passingGroups();
  const sum = (column) => groups.reduce((total, group) => total + (DATA.values.plain[column][group] || 0), 0);
  const hasBars = block.drawn.columns.some(({ label }) => label === LOW.label);
  const parts = [
    `${ofCell ? `${cellTitle()}: ` : ""}${counted(sum("planned"), "message")} in ${counted(sum("runs"), "run")}`,
    ...(hasBars ? ["bars are 95 % intervals, between runs where there are three or more"] : []),
    ...factsOf("Devices", "Link", "Middleware"),
  ];
  const how = block.article.querySelector(".how").textContent;
  return `${block.title()}. ${how}${foot && ` ${foot.trim()}`} ${parts.join("; ")}.`;
}

const factsOf = (...labels) =>
  [...document.querySelectorAll("dl > div")]
    .map((fact) => [...fact.children].map((one) => one.textContent))
    .filter(([label]) => labels.includes(label))
    .map(([, text]) => text);

const measuredWith = () => [DATA.title, ...factsOf("When", "Versions"), DATA.made_by].join("; ");

/** What a paper shows, and what is there instead where a campaign varies less. */
// prettier-ignore
const PRINTED_FIGURES = [
  "latency_by_rate", "domain_difference", "relay_time", "by_device", "latency_by_size", "vendor_comparison",
  "bridge_cost", "dots", "breakdown", "percentile_curve", "ecdf", "timeline",
];
const A4 = "210mm 297mm; margin: 15mm 18mm"; // 174 mm between the margins
const CAPTION_HEIGHT = 116; // px of a figure's caption

/** Four figures as a paper has them, each with a caption that says how to read it and what it was measured with. */
async function savePaper() {
  const before = { ...view };
  choosePaper(true);
  const figures = [];
  try {
    for (const name of PRINTED_FIGURES) {
      const block = blocks.find((one) => one.name === name);
      const pictures = block ? picturesOf(block, "", { mm: 174, title: "", below: CAPTION_HEIGHT }) : [];
      if (pictures.length && figures.length < 4) figures.push({ pictures, caption: captionOf(block, pictures) });
    }
  } finally {
    Object.assign(view, before);
  }
  const numbered = ({ length }, at, part) => `Figure ${at + 1}${length > 1 ? ` (${part + 1} of ${length})` : ""}.`;
  const pages = figures.flatMap(({ pictures, caption }, at) =>
    pictures.map((picture, part) => {
      const words = [`${numbered(pictures, at, part)} ${caption}`, measuredWith()];
      return { picture, size: A4, words };
    }),
  );
  await printSheets("paper", pages);
}

/** The bar above the figures: how wide pictures are, and all of them at once. */
function buildPictureBar() {
  const select = element(
    "select",
    { id: "save-width" },
    ...PICTURE_WIDTHS.map(({ key, label }) => element("option", { value: key }, label)),
  );
  const buttons = ["svg", "png", "pdf", "tex"].map((format) => {
    const button = element(
      "button",
      {
        type: "button",
        class: "quiet",
        "data-save-all": format,
        "aria-label": `Save all figures as ${format.toUpperCase()}`,
      },
      format === "tex" ? "LaTeX" : format.toUpperCase(),
    );
    button.addEventListener("click", () => saveAll(format));
    return button;
  });
  const paper = element("button", { type: "button", class: "quiet", id: "save-paper" }, "paper.pdf");
  paper.title = "Four figures as a paper has them, with captions and versions: save as PDF in the dialog of print";
  paper.addEventListener("click", savePaper);
  document
    .getElementById("figures-title")
    .after(
      element(
        "p",
        { class: "choice pictures-bar" },
        element("label", {}, "Pictures are ", select),
        " Save all: ",
        ...buttons,
        " ",
        paper,
      ),
    );
}

/** Which panel of a figure its pictures show; hidden where there is only one. */
function showPanelChoice(block) {
  const select = block.article.querySelector("[data-panel]");
  const panels = block.drawn.data.length ? block.drawn.titles : [];
  const chosen = select.value;
  select.replaceChildren(
    element("option", { value: "" }, "All panels"),
    ...panels.map(({ axis, title }) => element("option", { value: axis }, shorten(title, 40))),
  );
  if (panels.some(({ axis }) => axis === chosen)) select.value = chosen;
  select.hidden = panels.length < 2;
}

/** The summary of all groups, every column and type, as the analysis wrote it beside the page. */
function saveParquet() {
  const packed = atob(DATA.parquet);
  const bytes = Uint8Array.from(packed, (character) => character.charCodeAt(0));
  saveBlob("summary.parquet", new Blob([bytes], { type: "application/vnd.apache.parquet" }));
}
