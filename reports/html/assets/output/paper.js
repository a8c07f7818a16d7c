"use strict";
// On paper: white, as wide as A4 and US Letter both have room for; what is open on the screen and a paper's figures of
// few panels, a finding in a few lines, no column cut off.
const MOST_PRINTED = 12; // rows of the table of all results
const MOST_PANEL_ROWS = 12; // rows of panels of the figures that paper opens
const OPENED_ON_PAPER = ".first details:not([open], .further, .findings *)";
const CLOSED_ON_PAPER = ".findings details[open]"; // each place of each finding is in the JSON report

/** Redraws at the width of paper, and returns what puts the screen back. */
function toPaper() {
  const root = document.documentElement;
  const themeBefore = root.dataset.theme;
  const figures = PRINTED_FIGURES.map((name) => blocks.find((one) => one.name === name)).filter(Boolean);
  let room = MOST_PANEL_ROWS;
  for (const figure of figures.slice(0, 4)) figure.plan(); // one that was never in the window
  const fitting = figures.slice(0, 4).filter(({ rows }) => (room -= rows.length) >= 0);
  const folds = fitting.map(({ article }) => article.querySelector(".fold:not([open])"));
  const opened = [...document.querySelectorAll(OPENED_ON_PAPER), ...folds.filter(Boolean)];
  const closed = [...document.querySelectorAll(CLOSED_ON_PAPER)];
  setTheme("light");
  root.classList.add("paper");
  for (const details of opened) details.open = true;
  for (const details of closed) details.open = false;
  for (const block of blocks) {
    block.spoil();
    block.draw();
  }
  showGroups({ most: MOST_PRINTED });
  const cut = [...document.querySelectorAll("main table.data")]
    .filter((table) => table.getClientRects().length)
    .map(cutColumns)
    .filter(Boolean);
  return () => {
    for (const undo of cut) undo();
    for (const details of opened) details.open = false;
    for (const details of closed) details.open = true;
    root.classList.remove("paper");
    setTheme(themeBefore);
    showGroups();
    redraw();
  };
}

/** A table that is wider than the paper becomes several, each with the columns that stay; returns what undoes it. */
function cutColumns(table) {
  const room = table.parentElement.clientWidth;
  const widths = [...table.rows[0].cells].map((cell) => cell.getBoundingClientRect().width);
  if (table.getBoundingClientRect().width <= room + 1) return null;
  const stay = Number(table.dataset.stay || 1);
  const held = widths.slice(0, stay).reduce((sum, width) => sum + width, 0);
  const parts = [];
  let used = Infinity;
  for (let column = stay; column < widths.length; column += 1) {
    if (used + widths[column] > room) {
      parts.push([]);
      used = held;
    }
    parts[parts.length - 1].push(column);
    used += widths[column];
  }
  const copies = parts.map((columns) => {
    const copy = table.cloneNode(true);
    const kept = new Set([...Array(stay).keys(), ...columns]);
    for (const row of copy.rows)
      for (let column = row.cells.length - 1; column >= 0; column -= 1) if (!kept.has(column)) row.deleteCell(column);
    return copy;
  });
  table.replaceWith(...copies);
  return () => {
    copies[0].before(table);
    for (const copy of copies) copy.remove();
  };
}

let toScreen = () => {};
addEventListener("beforeprint", () => {
  toScreen = document.getElementById("sheets") ? () => {} : toPaper();
});
addEventListener("afterprint", () => toScreen());
