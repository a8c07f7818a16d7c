"use strict";
// Each figure takes its room at once, is drawn when it comes near the window, and again when the view changes.
const QUIET = { displayModeBar: false, responsive: false, doubleClick: "reset" };

// Rows of figures within reach of a scroll; the observer calls when one comes near or goes.
const NEAR = new Set();
const SEEN = new IntersectionObserver(
  (entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) NEAR.add(target);
      else NEAR.delete(target);
    }
    drawNear();
  },
  { rootMargin: "400px" },
);

/** Whether a part is in the window. The content of a closed fold has a position for the browser, but nobody sees it. */
function isOnScreen(part) {
  if (part.parentElement.closest("details:not([open])")) return false;
  const { top, bottom } = part.getBoundingClientRect();
  return bottom > 0 && top < innerHeight;
}

const [PRINTED_GRID, SCREEN_GRID] = [800, 1400]; // px that a labelled grid is high at most
const FOLDED_ON_PHONES = ["timeline", "host_load"];

class FigureBlock {
  constructor(article) {
    this.name = article.dataset.figure;
    this.figure = DATA.figures[this.name];
    this.article = article;
    this.plot = article.querySelector(".plot");
    this.details = article.querySelector(".as-table");
    this.fold = article.querySelector(".fold");
    this.heading = article.querySelector("h3");
    if (isNarrow(innerWidth) && FOLDED_ON_PHONES.includes(this.name)) this.fold.open = false;
    this.all = false; // more panels than MOST_PANELS
    this.painted = new Set(); // places of rows
    this.spoil();
    this.sorting = { column: -1, descending: false };
    this.details.addEventListener("toggle", () => this.showRows());
    this.fold.addEventListener("toggle", () => {
      if (this.fold.open) this.redraw();
    });
    for (const button of article.querySelectorAll("[data-save]")) {
      button.setAttribute("aria-label", `Save "${this.figure.title}" as ${button.textContent}`);
      button.addEventListener("click", () => this.save(button.dataset.save));
    }
  }

  /** The view changed: what was drawn is no longer right. */
  spoil() {
    this.planned = false;
    this.painted.clear();
    this.heading.textContent = this.title();
  }

  /**
   * Works out what is drawn, and takes its room on the page: links within it land where they say before all is drawn.
   */
  plan() {
    if (this.planned) return;
    this.planned = true;
    // A figure that is folded has no width of its own yet.
    const width = Math.floor(this.plot.clientWidth || this.article.clientWidth);
    const draw = (all) => KINDS[this.figure.kind](this.figure.plan, width, all);
    const isGrid = isPaper() && PAPER_FIGURES.includes(this.name);
    const height = document.documentElement.classList.contains("paper") ? PRINTED_GRID : SCREEN_GRID;
    this.drawn = draw(isGrid ? { page: 0, height } : this.all);
    const empty = this.drawn.data.length === 0;
    const further = isGrid ? this.drawn.pages - 1 : 0;
    this.rows = empty ? [] : isGrid ? [this.drawn] : rowsOf(this.drawn);
    for (let page = 1; page <= further; page += 1) this.rows.push(draw({ page, height }));
    this.plot.classList.toggle("bare", empty);
    while (this.plot.children.length > this.rows.length) this.drop(this.plot.lastElementChild);
    while (this.plot.children.length < this.rows.length)
      SEEN.observe(this.plot.appendChild(element("div", { class: "row" })));
    this.rows.forEach(({ layout }, place) => {
      this.plot.children[place].style.height = `${layout.height}px`;
    });
    this.article.querySelector(".legend").replaceChildren(...this.legend());
    this.article.querySelector(".note").textContent = this.note(empty);
    for (const button of this.article.querySelectorAll("[data-save]")) button.disabled = empty;
    showPanelChoice(this);
    this.showRows();
  }

  /** The page is renewed: nothing of this figure stays. */
  leave() {
    for (const row of [...this.plot.children]) this.drop(row);
  }

  drop(row) {
    SEEN.unobserve(row);
    NEAR.delete(row);
    Plotly.purge(row);
    row.remove();
  }

  /** Its own look changed: it was opened, or shows all panels. */
  redraw() {
    this.spoil();
    this.draw(isOnScreen);
    drawNear();
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
        row.on("plotly_click", ({ points: [point] }) => {
          const group = groupOfPoint(point);
          if (group !== null) openGroup(group);
        });
        row.on("plotly_hover", ({ points: [point] }) => this.highlight(point.data.meta));
        row.on("plotly_unhover", () => this.highlight(null));
      }
    });
  }

  note(empty) {
    const { missing, foot } = this.drawn;
    const groups = counted(missing, "result");
    const notes = [];
    if (empty) notes.push(missing ? "Nothing to draw here:" : "Nothing passes the filters here.");
    if (missing)
      notes.push(
        `${groups} of this view ha${missing === 1 ? "s" : "ve"} no such value ` +
          "(too few messages, or a trace is missing).",
      );
    if (!empty && foot) notes.push(foot);
    return notes.join(" ");
  }

  /** What the figure shows, in the words of the chosen metric and statistic. */
  title() {
    const { title, follows, kind } = this.figure;
    const of = kind === "bars" ? "all messages" : ofWhom();
    return follows ? `${title.replace(/^Latency/, labelOf("metric"))}, ${labelOf("statistic")} of ${of}` : title;
  }

  /** The beginning of the names of its files. */
  fileName() {
    const said = this.figure.follows ? `-${view.metric}-${view.statistic}` : "";
    return `dds-trace-${this.name.replace(/^latency_/, "")}${said}`.replaceAll("_", "-");
  }

  /** One button for each line, which switches it off and on everywhere; the parts of stacked bars only have names. */
  legend() {
    const more = this.drawn.panels > this.drawn.shown ? [this.moreButton()] : [];
    if (this.drawn.parts)
      return [
        ...this.drawn.parts.map(({ name, color, tint }) =>
          element("span", {}, swatch({ color, bar: true, tint }), name),
        ),
        ...more,
      ];
    if (!this.drawn.legend) return more;
    const { dimension, options } = this.drawn.legend;
    return [
      ...options.map((option) => {
        const look = lookOf(dimension, option);
        const button = element(
          "button",
          { type: "button", class: "line", "aria-pressed": String(!view.hidden.has(look.key)), "data-line": look.key },
          swatch({ ...look, bar: this.figure.kind === "bars" }),
          look.label,
        );
        button.addEventListener("click", () => {
          if (!view.hidden.delete(look.key)) view.hidden.add(look.key);
          refreshAll();
          this.article.querySelector(`[data-line="${look.key}"]`)?.focus();
        });
        for (const [on, off] of [
          ["pointerenter", "pointerleave"],
          ["focus", "blur"],
        ]) {
          button.addEventListener(on, () => this.highlight(look.key));
          button.addEventListener(off, () => this.highlight(null));
        }
        return button;
      }),
      ...more,
    ];
  }

  moreButton() {
    const button = element(
      "button",
      { type: "button", class: "quiet more" },
      `${this.drawn.shown} of ${this.drawn.panels} panels: show all`,
    );
    button.addEventListener("click", () => {
      this.all = true;
      this.redraw();
      this.heading.scrollIntoView();
    });
    return button;
  }

  /** Fades every line but one; none without a key. Plotly binds each trace to its element. */
  highlight(key) {
    for (const node of this.plot.querySelectorAll(".trace")) {
      const meta = node.__data__?.[0]?.trace?.meta;
      node.style.opacity = !key || !meta || meta === key ? "" : "0.15";
    }
  }

  showRows() {
    if (this.details.open && this.drawn)
      showTable(this.article.querySelector(".table-place"), this.title(), this.drawn.columns, this.drawn.rows, {
        sorting: this.sorting,
      });
  }

  save(format) {
    this.plan();
    const name = this.fileName();
    if (format === "csv") return saveCsv(name, this.drawn.columns, this.drawn.rows);
    return savePicture(name, this, format);
  }
}

const SYMBOL_PATHS = {
  circle: "M4.5 0A4.5 4.5 0 1 1-4.5 0A4.5 4.5 0 1 1 4.5 0Z",
  square: "M-4-4H4V4H-4Z",
  diamond: "M0-5.5L5.5 0L0 5.5L-5.5 0Z",
  "triangle-up": "M0-5L5 4H-5Z",
  "triangle-down": "M0 5L5-4H-5Z",
  cross: "M-5-2H-2V-5H2V-2H5V2H2V5H-2V2H-5Z",
  hexagon: "M0-5L4.5-2.5V2.5L0 5L-4.5 2.5V-2.5Z",
  star: "M0-6L1.5-1.5H6L2.5 1.5L4 6L0 3L-4 6L-2.5 1.5L-6-1.5H-1.5Z",
  pentagon: "M0-5L4.8-1.5L2.9 4H-2.9L-4.8-1.5Z",
  hourglass: "M4.5 5H-4.5L4.5-5H-4.5Z",
  bowtie: "M5 4.5V-4.5L-5 4.5V-4.5Z",
  "diamond-tall": "M0-6L3.5 0L0 6L-3.5 0Z",
  "diamond-wide": "M0-3.5L6 0L0 3.5L-6 0Z",
  "triangle-left": "M-5 0L4-5V5Z",
  "triangle-right": "M5 0L-4-5V5Z",
  "star-diamond": "M0-6L2-2L6 0L2 2L0 6L-2 2L-6 0L-2-2Z",
  hexagram: "M0-6L1.7-3H5.2L3.5 0L5.2 3H1.7L0 6L-1.7 3H-5.2L-3.5 0L-5.2-3H-1.7Z",
  "star-triangle-up": "M0-6L1.5 1L6 4L0 3L-6 4L-1.5 1Z",
  x: "M-5-3L-3-5L0-2L3-5L5-3L2 0L5 3L3 5L0 2L-3 5L-5 3L-2 0Z",
};
const DASH_ARRAYS = { solid: "", dash: "6 4", dot: "2 3", dashdot: "6 3 2 3", longdash: "9 4", longdashdot: "9 3 2 3" };
/** The small picture in a legend: line and symbol (drawn by plotly's own rule), or a bar. */
function swatch({ color, symbol, dash, tint = 1, bar = false }) {
  const draw = (tag, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  };
  const picture = draw("svg", { width: 34, height: 14, viewBox: "-17 -7 34 14", "aria-hidden": "true" });
  if (bar) {
    picture.append(
      draw("rect", {
        x: -9,
        y: -6,
        width: 18,
        height: 12,
        fill: tinted(color, tint),
        stroke: color,
        "stroke-width": 1.2,
      }),
    );
    return picture;
  }
  picture.append(
    draw("line", {
      x1: -17,
      x2: 17,
      y1: 0,
      y2: 0,
      stroke: color,
      "stroke-width": 1.8,
      "stroke-dasharray": DASH_ARRAYS[dash],
    }),
  );
  picture.append(draw("path", { d: SYMBOL_PATHS[symbol], fill: color, stroke: color, "stroke-width": 1 }));
  return picture;
}
