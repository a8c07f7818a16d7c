"use strict";
// Downloads: figures as SVG, PNG and PDF in the widths of print, numbers as CSV and Parquet. Files are made in the
// page; nothing is sent.

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
const PNG_SCALE = 600 / 96; // 600 dots an inch where the width is one of print

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

/** A figure as it is drawn for paper: on white, in the light colours, at the chosen width, one panel of it or all. */
function pictureOf(block, panel = "") {
  const root = document.documentElement;
  const { mm } = chosenWidth();
  const before = root.dataset.theme;
  const width = mm === null ? block.drawn.layout.width : Math.round(mm * PX_PER_MM);
  root.dataset.theme = "light"; // for as long as the colours are read: nothing is painted in between
  try {
    const drawn = KINDS[block.figure.kind](block.figure.plan, width, panel || LABELLED);
    const title = block.title ? block.title() : block.figure.title;
    return onWhite(panel ? panelOf(drawn, panel, width) : drawn, title, width, mm);
  } finally {
    root.dataset.theme = before;
  }
}

/** The panels of a figure {axis, title}, by the y axis of each. */
function panelsOf({ layout }) {
  const titles = (layout.annotations || []).filter((note) => note.xref === "paper" && note.yref === "paper");
  return Object.keys(layout)
    .filter((key) => key.startsWith("yaxis") && !layout[key].overlaying)
    .map((axis) => {
      const x = layout[layout[axis].anchor.replace("x", "xaxis")];
      const named = titles.find(
        (note) => Math.abs(note.y - layout[axis].domain[1]) < 1e-6 && Math.abs(note.x - x.domain[0]) < 1e-6,
      );
      return { axis, title: named ? named.text.replace(/<[^>]*>/g, "") : "" };
    })
    .filter((one) => one.title);
}

/** One panel of a figure as a figure. */
function panelOf({ data, layout }, axis, width) {
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
      title: { text: panelsOf({ layout }).find((one) => one.axis === axis)?.title || "" },
    },
  };
}

/** The figure with title and legend of its own on white ground; room for both is made above it. */
function onWhite({ data, layout }, title, width, mm) {
  const seen = new Set();
  const traces = data.map((trace) => {
    const named = trace.name && trace.type !== "heatmap" && !seen.has(trace.name);
    if (trace.name) seen.add(trace.name);
    return { ...trace, showlegend: Boolean(named), legendgroup: trace.name };
  });
  const size = mm !== null && mm < 100 ? 10 : 11;
  const lines = [...seen].reduce((rows, name) => {
    const taken = 46 + name.length * size * 0.56;
    if (rows.length && rows[rows.length - 1] + taken <= width) rows[rows.length - 1] += taken;
    else rows.push(taken);
    return rows;
  }, []).length;
  const head = wrapped(layout.title?.text ? `${title}: ${layout.title.text}` : title, (width - 16) / (size * 0.62));
  const titled = 10 + head.length * (size + 5);
  const above = titled + (seen.size > 1 ? lines * (size + 10) + 6 : 0);
  const height = Math.round(layout.height + above);
  return {
    data: traces,
    layout: {
      ...layout,
      width,
      height,
      paper_bgcolor: "#ffffff",
      plot_bgcolor: "#ffffff",
      showlegend: seen.size > 1,
      margin: { ...layout.margin, t: layout.margin.t + above },
      title: {
        text: head.map(plain).join("<br>"),
        x: 0,
        xref: "container",
        y: 1,
        yref: "container",
        yanchor: "top",
        pad: { t: 8, l: 8 },
        font: { size: size + 2, color: layout.font.color },
      },
      legend: {
        orientation: "h",
        x: -layout.margin.l / (width - layout.margin.l - layout.margin.r),
        xanchor: "left",
        y: 1 - titled / height,
        yref: "container",
        yanchor: "top",
        font: { size },
      },
    },
    mm,
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
  const picture = pictureOf(block, block.article.querySelector("[data-panel]")?.value);
  if (format === "pdf") {
    printPictures([await svgOf(picture)], [picture]);
    return;
  }
  saveBlob(`${name}.${format}`, await pictureBlob(picture, format));
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

/** Every figure of the page in one zip; as PDF one page each. */
async function saveAll(format) {
  for (const block of blocks) block.plan();
  const drawn = blocks.filter((block) => block.drawn.data.length);
  if (format !== "pdf") {
    const files = [];
    for (const block of drawn) {
      const content = new Uint8Array(await (await pictureBlob(pictureOf(block), format)).arrayBuffer());
      files.push({ name: `${block.fileName()}.${format}`, content });
    }
    saveBlob(`dds-trace-figures-${format}.zip`, new Blob(zipParts(files), { type: "application/zip" }));
    return;
  }
  const pictures = drawn.map((block) => pictureOf(block));
  printPictures(await Promise.all(pictures.map(svgOf)), pictures);
}

/** Hands pictures to the browser's own print, as pages of their very size: "Save as PDF" there keeps them vectors. */
function printPictures(svgs, pictures) {
  const remove = layOutPictures(svgs, pictures);
  print();
  remove();
}

function layOutPictures(svgs, pictures) {
  const pages = pictures.map(
    ({ layout }, place) =>
      `@page picture${place} { size: ${layout.width}px ${layout.height}px; margin: 0; }\n` +
      `.picture:nth-child(${place + 1}) { page: picture${place}; }`,
  );
  const style = element("style", {}, pages.join("\n"));
  const place = element("div", { id: "pictures" });
  for (const svg of svgs) {
    const page = place.appendChild(element("div", { class: "picture" }));
    page.append(document.adoptNode(new DOMParser().parseFromString(svg, "image/svg+xml").documentElement));
  }
  document.head.append(style);
  document.body.append(place);
  document.documentElement.classList.add("pictures");
  return () => {
    document.documentElement.classList.remove("pictures");
    style.remove();
    place.remove();
  };
}

/** The bar above the figures: how wide pictures are, and all of them at once. */
function buildPictureBar() {
  const select = element(
    "select",
    { id: "save-width" },
    ...PICTURE_WIDTHS.map(({ key, label }) => element("option", { value: key }, label)),
  );
  const buttons = ["svg", "png", "pdf"].map((format) => {
    const button = element(
      "button",
      {
        type: "button",
        class: "quiet",
        "data-save-all": format,
        "aria-label": `Save all figures as ${format.toUpperCase()}`,
      },
      format.toUpperCase(),
    );
    button.addEventListener("click", () => saveAll(format));
    return button;
  });
  document
    .getElementById("figures-title")
    .after(
      element(
        "p",
        { class: "choice pictures-bar" },
        element("label", {}, "Pictures are ", select),
        " Save all: ",
        ...buttons,
      ),
    );
}

/** Which panel of a figure its pictures show; hidden where there is only one. */
function showPanelChoice(block) {
  const select = block.article.querySelector("[data-panel]");
  const panels = block.drawn.data.length ? panelsOf(block.drawn) : [];
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
