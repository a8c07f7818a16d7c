"use strict";
// Each figure takes its room at once, is drawn when it comes near the window, and again when the view changes.
const QUIET = { displayModeBar: false, responsive: false, doubleClick: "reset" };

// Rows of figures within reach of a scroll; the observer calls when one comes near or goes.
const NEAR = new Set();
const SEEN = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (isIntersecting) NEAR.add(target);
    else NEAR.delete(target);
  }
  for (const block of blocks) block.draw((row) => NEAR.has(row));
}, { rootMargin: "400px" });

function isOnScreen(part) {
  const { top, bottom } = part.getBoundingClientRect();
  return bottom > 0 && top < innerHeight;
}

class FigureBlock {
  constructor(article) {
    this.name = article.dataset.figure;
    this.figure = DATA.figures[this.name];
    this.article = article;
    this.plot = article.querySelector(".plot");
    this.details = article.querySelector(".as-table");
    this.painted = new Set();   // places of rows
    this.spoil();
    this.sorting = { column: -1, descending: false };
    this.details.addEventListener("toggle", () => this.showRows());
    for (const button of article.querySelectorAll("[data-save]")) {
      button.setAttribute("aria-label", `Save "${this.figure.title}" as ${button.textContent}`);
      button.addEventListener("click", () => this.save(button.dataset.save));
    }
  }

  /** The view changed: what was drawn is no longer right. */
  spoil() {
    this.planned = false;
    this.painted.clear();
  }

  /** Works out what is drawn, and takes its room on the page: links within it land where they say before all is drawn. */
  plan() {
    if (this.planned) return;
    this.planned = true;
    this.drawn = KINDS[this.figure.kind](this.figure.plan, Math.floor(this.plot.clientWidth));
    const empty = this.drawn.data.length === 0;
    this.rows = empty ? [] : rowsOf(this.drawn);
    this.plot.classList.toggle("bare", empty);
    while (this.plot.children.length > this.rows.length) this.drop(this.plot.lastElementChild);
    while (this.plot.children.length < this.rows.length) SEEN.observe(this.plot.appendChild(element("div", { class: "row" })));
    this.rows.forEach(({ layout }, place) => { this.plot.children[place].style.height = `${layout.height}px`; });
    this.article.querySelector(".legend").replaceChildren(...this.legend());
    this.article.querySelector(".note").textContent = this.note(empty);
    for (const button of this.article.querySelectorAll("[data-save]")) button.disabled = empty;
    showPanelChoice(this);
    this.showRows();
  }

  /** The page is renewed: nothing of this figure stays. */
  leave() { for (const row of [...this.plot.children]) this.drop(row); }

  drop(row) {
    SEEN.unobserve(row);
    NEAR.delete(row);
    Plotly.purge(row);
    row.remove();
  }

  /** Draws every row, or only those that `wanted` of their elements picks. */
  draw(wanted = () => true) {
    this.plan();
    this.rows.forEach(({ data, layout }, place) => {
      const row = this.plot.children[place];
      if (this.painted.has(place) || !wanted(row)) return;
      this.painted.add(place);
      Plotly.react(row, data, layout, QUIET);
      if (!row.dataset.opens) {
        row.dataset.opens = "yes";
        row.on("plotly_click", ({ points: [point] }) => { const group = groupOfPoint(point); if (group !== null) openGroup(group); });
      }
    });
  }

  note(empty) {
    const { missing, foot } = this.drawn;
    const groups = counted(missing, "group");
    const notes = [];
    if (empty) notes.push(missing ? "Nothing to draw here:" : "Nothing passes the filters here.");
    if (missing) notes.push(`${groups} of this view ha${missing === 1 ? "s" : "ve"} no such value (too few messages, or a trace is missing).`);
    if (!empty && foot) notes.push(foot);
    return notes.join(" ");
  }

  legend() {
    if (this.drawn.parts) return this.drawn.parts.map(({ name, color, hatched }) => element("span", {}, swatch({ fill: color, hatched }), name));
    return [...this.drawn.series].sort((a, b) => a - b).map((place) => {
      const series = DATA.series[place];
      return element("span", {}, swatch({ series, bar: this.figure.kind === "pairs" }), series.label);
    });
  }

  showRows() {
    if (this.details.open && this.drawn) showTable(this.article.querySelector(".table-place"), this.figure.title, this.drawn.columns, this.drawn.rows, { sorting: this.sorting });
  }

  save(format) {
    this.plan();
    const name = `dds-trace-${this.name.replaceAll("_", "-")}`;
    if (format === "csv") return saveCsv(name, this.drawn.columns, this.drawn.rows);
    return savePicture(name, this, format);
  }
}

const SYMBOL_PATHS = {
  circle: "M4.5 0A4.5 4.5 0 1 1-4.5 0A4.5 4.5 0 1 1 4.5 0Z", square: "M-4-4H4V4H-4Z", diamond: "M0-5.5L5.5 0L0 5.5L-5.5 0Z",
  "triangle-up": "M0-5L5 4H-5Z", "triangle-down": "M0 5L5-4H-5Z", cross: "M-5-2H-2V-5H2V-2H5V2H2V5H-2V2H-5Z",
  hexagon: "M0-5L4.5-2.5V2.5L0 5L-4.5 2.5V-2.5Z", star: "M0-6L1.5-1.5H6L2.5 1.5L4 6L0 3L-4 6L-2.5 1.5L-6-1.5H-1.5Z",
};
const DASH_ARRAYS = { solid: "", dash: "6 4", dot: "2 3", dashdot: "6 3 2 3", longdash: "9 4", longdashdot: "9 3 2 3" };

/** The small picture in a legend: line and symbol, or a plain or hatched bar. */
function swatch({ series, bar = false, fill, hatched = bar && series.different }) {
  const draw = (tag, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  };
  const picture = draw("svg", { width: 34, height: 14, viewBox: "-17 -7 34 14", "aria-hidden": "true" });
  const color = fill || seriesColor(series);
  if (fill || bar) {
    picture.append(draw("rect", { x: -9, y: -6, width: 18, height: 12, fill: hatched ? "none" : color, stroke: color, "stroke-width": 1.2 }));
    if (hatched) picture.append(draw("path", { d: "M-9 0L-3-6M-9 6L3-6M-3 6L9-6M3 6L9 0", stroke: color, "stroke-width": 1.6 }));
    return picture;
  }
  const [symbol, variant = ""] = series.symbol.match(/^(.*?)(?:-(open|dot|open-dot))?$/).slice(1);
  picture.append(draw("line", { x1: -17, x2: 17, y1: 0, y2: 0, stroke: color, "stroke-width": 1.8, "stroke-dasharray": DASH_ARRAYS[series.dash] }));
  picture.append(draw("path", { d: SYMBOL_PATHS[symbol], fill: variant.includes("open") ? theme().ground : color, stroke: color, "stroke-width": 1.2 }));
  return picture;
}
