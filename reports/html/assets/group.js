"use strict";
// One group opened over the page: its numbers, its messages over time, its distribution, its parts and its runs.
const GROUP_FIGURES = ["timeline", "ecdf", "breakdown"];

const groupName = (group) => `${cellOf(group).label}, ${seriesOf(group).label}`;

/** The group of a mark, bar or tile that plotly says was clicked; null where it has none. */
const groupOfPoint = ({ data, pointNumber }) =>
  [pointNumber].flat().reduce((of, at) => of?.[at], data.customdata) ?? null;

const sheet = document.getElementById("group");

function openGroup(group) {
  view.group = group;
  writeAddress();
  showGroup();
}

/** Shows the group that the address names, or closes what was open. */
function showGroup() {
  const { group } = view;
  if (group === null) {
    if (sheet.open) sheet.close();
    return;
  }
  if (!sheet.open) sheet.showModal();
  document.getElementById("group-title").textContent = groupName(group);
  document.getElementById("group-said").textContent = groupSentence(group);
  const place = document.getElementById("group-figures");
  for (const old of place.querySelectorAll(".row")) Plotly.purge(old);
  place.replaceChildren();
  for (const name of GROUP_FIGURES.filter((one) => DATA.figures[one])) drawOf(group, name, place);
  const runs = DATA.runs.filter((run) => run.group === group);
  const columns = [
    { label: "Run" },
    { label: "Began" },
    { label: "Sent", format: formatCount },
    { label: "Received", format: formatCount },
    { label: "Median", unit: "ns", format: formatNs },
    { label: "Slowest", unit: "ns", format: formatNs },
  ];
  showTable(
    document.getElementById("group-runs"),
    "Runs of the result",
    columns,
    runs.map((run) => [run.name, run.began || null, run.sent, run.received, run.p50_ns, run.max_ns]),
  );
  sheet.scrollTop = 0;
}

function groupSentence(group) {
  const { times_ns: times, plain: values } = DATA.values;
  const said = ["p50", "p90", "p99", "max"]
    .filter((key) => times[view.metric][key][group] !== null)
    .map(
      (key) => `${DATA.statistics.find((one) => one.key === key).label} ${formatNs(times[view.metric][key][group])}`,
    );
  const measured = said.join(", ") || "no time was measured";
  const runs = counted(values.runs[group], "run");
  return `${sampleHover(group)} in ${runs}. ${labelOf("metric")} of all messages: ${measured}.`;
}

/** Draws a figure of the page as if only this group had passed the filters. */
function drawOf(group, name, place) {
  const { title, kind, plan } = DATA.figures[name];
  view.only = group;
  let drawn;
  try {
    drawn = KINDS[kind](plan, Math.min(place.clientWidth, 900));
  } finally {
    view.only = null;
  }
  if (!drawn.data.length) return;
  place.append(element("h3", {}, title));
  for (const { data, layout } of rowsOf(drawn)) {
    const row = place.appendChild(
      element("div", { class: "row", role: "img", "aria-label": `${title}: ${groupName(group)}` }),
    );
    row.style.height = `${layout.height}px`;
    Plotly.react(row, data, layout, QUIET);
  }
}

sheet.addEventListener("close", () => {
  if (view.group === null) return;
  view.group = null;
  writeAddress();
});
document.getElementById("group-close").addEventListener("click", () => sheet.close());
sheet.addEventListener("click", (event) => {
  if (event.target === sheet) sheet.close();
}); // outside of it
document.addEventListener("click", (event) => {
  const link = event.target.closest("[data-group]");
  if (!link) return;
  event.preventDefault();
  openGroup(Number(link.dataset.group));
});
