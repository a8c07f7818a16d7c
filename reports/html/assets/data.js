"use strict";
// The numbers of the page. Position i of every list under `values` and `groups` is group i.
const DATA = JSON.parse(UNPACKED.data);

/** An element with text (never markup) and children. */
function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** Text for plotly, which reads a little HTML in titles and hovers: nothing of a trace may be markup there. */
function plain(text) {
  return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
}

/** What distinguishes a group, for tables and hovers. */
function seriesOf(group) {
  return DATA.series[DATA.groups.series[group]];
}
function cellOf(group) {
  return DATA.cells[DATA.groups.cell[group]];
}
