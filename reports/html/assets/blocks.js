"use strict";
// Paper is light.
showTheme();
addEventListener("beforeprint", () => setTheme("light"));
addEventListener("afterprint", showTheme);

// Long tables show a page of results at a time; paper and a search of the browser without script get all of them.
const PAGE = 50;
const rows = [...document.querySelectorAll(".groups > tbody > tr")];
const more = document.getElementById("more");
let shownRows = 2 * PAGE;

function reveal(count) {
  if (more === null) return;
  rows.forEach((row, index) => { row.hidden = index >= count; });
  const left = Math.max(0, rows.length - count) / 2;
  more.hidden = left === 0;
  more.textContent = `Show ${Math.min(PAGE, left)} more of ${left}`;
}

if (more !== null) more.addEventListener("click", () => {
  const next = rows[shownRows];
  reveal(shownRows += 2 * PAGE);
  next.tabIndex = -1;
  next.focus();
});
addEventListener("beforeprint", () => reveal(rows.length));
addEventListener("afterprint", () => reveal(shownRows));
reveal(shownRows);
