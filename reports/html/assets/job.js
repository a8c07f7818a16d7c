"use strict";
// "Does it fit my job?": ranks what was measured for a message and a deadline, by the numbers of the page alone.
// Nothing is guessed: what was not measured is not known, and a command would decide it.
const JOB_METRIC = "response"; // from planned send to reply, so that a late sender does not look fast
const JOB_RUNS = 3; // fewest runs of a verdict
const percentileOf = (key) => DATA.percentiles.find((one) => one.key === key);
const FITS = ["meets", "likely", "unclear", "misses", "not known"];
const TYPED_UNITS = {
  ...{ B: 1, KB: 1e3, MB: 1e6, GB: 1e9, KiB: 1024, MiB: 1048576 },
  ...{ Hz: 1, ns: 1, us: 1e3, µs: 1e3, ms: 1e6, s: 1e9 },
};

/** A number with a unit out of `units` (the first one where none is typed); null for anything else. */
function typed(text, units) {
  const match = /^\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*([a-zµ]*)\s*$/i.exec(text);
  if (!match) return null;
  const unit = match[2] ? units.find((one) => one.toLowerCase() === match[2].toLowerCase()) : units[0];
  return unit && Number(match[1]) > 0 ? Number(match[1]) * TYPED_UNITS[unit] : null;
}

/** What the form asks for, or the label of the field that is not understood. */
function readJob(form) {
  const job = {
    data: form.elements.data.value,
    bytes: typed(form.elements.size.value, ["B", "KB", "MB", "GB", "KiB", "MiB"]),
    hz: typed(form.elements.rate.value, ["Hz"]),
    deadline_ns: typed(form.elements.deadline.value, ["ms", "ns", "us", "µs", "s"]),
    share: form.elements.share.value,
    domain: form.elements.domain.value,
    link: form.elements.link.value,
  };
  const named = { size: job.bytes, rate: job.hz, deadline: job.deadline_ns };
  const wrong = Object.keys(named).find((name) => named[name] === null);
  return wrong ? { wrong } : job;
}

/** Whether a group may carry the job: its data, domains and link. */
function isForJob(group, job) {
  return (
    cellOf(group).data === job.data &&
    (!job.domain || seriesOf(group).domain === job.domain) &&
    (!job.link || DATA.dimensions.link.options[DATA.dimensions.link.index[group]].label === job.link)
  );
}

/** Time within which the share of planned messages was answered: Infinity if too many were lost, null if unknown. */
function timeOfJob(group, share) {
  const received = DATA.curves.shares[group];
  const level = percentileOf(share).share;
  if (received === null || received < level) return received === null ? null : Infinity;
  if (received === 1) return DATA.values.times_ns[JOB_METRIC][share][group];
  const at = DATA.curves.levels.findIndex((one) => one >= level / received - 1e-12);
  return DATA.curves.values_ns[JOB_METRIC][group][at] ?? null;
}

/** How one result fits: {group, fit, time, low, high, why}. */
function fitOf(group, job) {
  const time = timeOfJob(group, job.share);
  const ends = (side) => DATA.intervals[side][JOB_METRIC]?.[job.share]?.[group] ?? null;
  const [low, high] = [ends("low_ns"), ends("high_ns")];
  const runs = DATA.values.plain.runs[group];
  const held = DATA.values.plain.achieved_rate_hz[group];
  const between = Boolean(DATA.intervals.is_between[JOB_METRIC]?.[job.share]?.[group]) && runs >= JOB_RUNS;
  const rated = (fit, why = "") => ({ group, fit, time, low, high, runs, why });
  if (time === null) return rated("not known", `too few messages for ${percentText(job.share)}`);
  if (held !== null && held < 0.98 * cellOf(group).hz)
    return rated("misses", `sent at ${formatHz(held)} where ${formatHz(cellOf(group).hz)} were planned`);
  const lost = `${formatRatio(1 - DATA.curves.shares[group])} lost`;
  if (time === Infinity) return rated(runs >= JOB_RUNS ? "misses" : "unclear", lost);
  if (time > job.deadline_ns) {
    if (between && low !== null && low > job.deadline_ns) return rated("misses");
    return rated("unclear", between ? "the deadline is within the interval" : `rests on ${counted(runs, "run")}`);
  }
  if (!between) return rated("likely", `rests on ${counted(runs, "run")}; a verdict needs ${JOB_RUNS}`);
  if (DATA.curves.shares[group] < 1) return rated("likely", lost);
  if (high === null || high > job.deadline_ns) return rated("unclear", "the deadline is within the interval");
  return rated("meets");
}

const percentText = (share) => `${percent(percentileOf(share).share)} %`;

/** Results for the job, best first. */
function ranked(job) {
  return Array.from({ length: DATA.groups.count }, (_, group) => group)
    .filter((group) => isForJob(group, job) && cellOf(group).bytes === job.bytes && cellOf(group).hz === job.hz)
    .map((group) => fitOf(group, job))
    .sort(
      (a, b) =>
        FITS.indexOf(a.fit) - FITS.indexOf(b.fit) || (a.high ?? a.time ?? Infinity) - (b.high ?? b.time ?? Infinity),
    );
}

/** The commands that would decide: a relay and a ping of a setup, with enough messages for the share. */
function decidingCommands(series, job) {
  const [relay, ping] = DATA.series[series].commands;
  const { kind } = DATA.cells.find(({ data }) => data === job.data);
  const size = job.bytes % 1000 ? `${job.bytes}` : inUnits(job.bytes, BYTE_UNITS).replace(" ", "");
  const message = [`--data ${kind}`, ...(kind === "imu" ? [] : [`--size ${size}`]), `--rate ${digits(job.hz)}`];
  const count = `--messages ${percentileOf(job.share).messages}`;
  return [relay, ping.replace(/--data .*--messages \d+/, () => [...message, count].join(" "))];
}

/** The answer in words: a sentence, the commands that would decide, and rows for the table. */
function answerJob(job) {
  const found = ranked(job);
  const deadline = `${percentText(job.share)} of the messages within ${formatNs(job.deadline_ns)}`;
  const label = ({ group }) => seriesOf(group).label;
  const named = (fits) => found.filter(({ fit }) => fits.includes(fit));
  const [best] = found;
  const candidates = found.length ? found : forAnySize(job);
  const open = candidates.find(({ fit }) => !["meets", "misses"].includes(fit));
  const meets = named(["meets"]);
  const first = meets.length && meets.filter(({ low }) => low <= meets[0].high);
  let sentence;
  if (!found.length) sentence = `Not known: ${notMeasured(job)}`;
  else if (meets.length)
    sentence =
      `${first.map(label).join("; ")} ${first.length === 1 ? "meets" : "meet"} it: ${deadline}` +
      `${first.length > 1 ? ", with no difference between them in these traces" : ""}.`;
  else if (best.fit === "likely")
    sentence = `Nothing is shown to meet it; likely: ${named(["likely"]).map(label).join("; ")}.`;
  else if (named(["misses"]).length === found.length)
    sentence = `Everything that was measured misses it: ${deadline}.`;
  else sentence = "Nothing is shown to meet it, and not everything to miss it.";
  return { found, sentence, commands: open ? decidingCommands(DATA.groups.series[open.group], job) : [] };
}

/** Results of other messages on the setups for the job, as what could be measured next. */
function forAnySize(job) {
  return Array.from({ length: DATA.groups.count }, (_, group) => group)
    .filter((group) => isForJob(group, job))
    .map((group) => ({ group, fit: "not known" }));
}

function notMeasured(job) {
  const cells = [...new Set(forAnySize(job).map(({ group }) => cellOf(group)))];
  if (!cells.length) return `no ${job.data} was measured there.`;
  const near = cells.sort((a, b) => distance(a, job) - distance(b, job)).slice(0, 3);
  return `this message was not measured there. The nearest that were: ${near.map((cell) => cell.label).join("; ")}.`;
}
const distance = (cell, job) => Math.abs(Math.log(cell.bytes / job.bytes)) + Math.abs(Math.log(cell.hz / job.hz));

function buildJob() {
  const form = document.getElementById("job-form");
  if (!form) return; // nothing was measured
  const choice = (name, label, options) =>
    element(
      "label",
      {},
      label,
      element("select", { name }, ...options.map(([value, text]) => element("option", { value }, text))),
    );
  const entry = (name, label, value, listed) =>
    element(
      "label",
      {},
      label,
      element("input", { name, value, size: "8", list: `job-${name}`, autocomplete: "off" }),
      element("datalist", { id: `job-${name}` }, ...listed.map((text) => element("option", { value: text }))),
    );
  const unique = (values) => [...new Set(values)].map((value) => [value, value]);
  const cell = DATA.cells[shownCell() ?? 0];
  form.replaceChildren(
    choice("data", "Data ", unique(DATA.cells.map(({ data }) => data))),
    entry("size", "Size ", cell.size, unique(DATA.cells.map(({ size }) => size)).map(([text]) => text)),
    entry("rate", "Rate ", cell.rate, unique(DATA.cells.map(({ rate }) => rate)).map(([text]) => text)),
    entry("deadline", "Deadline ", "50 ms", []),
    choice("share", "for ", DATA.percentiles.slice(1).map(({ key }) => [key, percentText(key)])),
    choice("domain", "Domains ", [["", "any"], ["same", "same"], ["different", "different"]]),
    choice("link", "Link ", [["", "any"], ...unique(DATA.dimensions.link.options.map(({ label }) => label))]),
  );
  form.elements.data.value = cell.data;
  form.elements.share.value = "p99";
  form.addEventListener("input", showJob);
  form.addEventListener("submit", (event) => event.preventDefault());
  showJob();
}

const JOB_COLUMNS = [
  { label: "Setup" },
  { label: "Meets it" },
  { label: "Time", unit: "ns", format: (ns) => (ns === Infinity ? "lost" : formatNs(ns)) },
  { label: "95 % from", unit: "ns", format: formatNs },
  { label: "to", unit: "ns", format: formatNs },
  { label: "Received", format: formatRatio },
  { label: "Why" },
];

/** Show the answer; the commands once the form was touched (`event`). */
function showJob(event) {
  const job = readJob(document.getElementById("job-form"));
  const { found, sentence, commands } = job.wrong
    ? { found: [], sentence: `The ${job.wrong} is not understood; write a number and a unit.`, commands: [] }
    : answerJob(job);
  document.getElementById("job-answer").textContent = sentence;
  const table = document.getElementById("job-table");
  table.replaceChildren();
  if (found.length)
    showTable(
      table,
      "Setups for the job, best first",
      JOB_COLUMNS,
      found.map(({ group, fit, time, low, high, why }) => [
        seriesOf(group).label,
        fit,
        time,
        low,
        high,
        DATA.curves.shares[group],
        why || null,
      ]),
    );
  const decide = document.getElementById("job-command");
  decide.hidden = !event || !commands.length;
  decide.querySelector("code").textContent = commands.join("\n");
}
