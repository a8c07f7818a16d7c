// The page of the studio: it sends the form, and shows the state that the program tells; it decides nothing.
const byId = id => document.getElementById(id);
const form = byId("ask");

function element(tag, text = "", className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

const time = ms => ms === null || ms === undefined ? "–" : ms >= 1000 ? `${(ms / 1000).toPrecision(3)} s` : ms >= 1 ? `${+ms.toPrecision(3)} ms` : `${+(1000 * ms).toPrecision(3)} µs`;

async function post(path, value) {
  try {
    const answer = await fetch(path, { method: "POST", body: JSON.stringify(value) });
    return answer.ok ? (await answer.json()).error : `refused (${answer.status}): open the address that the command printed`;
  } catch {
    return "the program has ended";
  }
}

function showDevices() {
  byId("other").textContent = form.host.value || "this machine";
  byId("between").textContent = form.link.value || (form.host.value ? "your network" : "loopback");
}

function fill(values) {
  for (const [name, value] of Object.entries(values)) if (form.elements[name]) form.elements[name].value = value;
  showDevices();
  form.querySelector(".primary").focus();
}

/** A place in percent on a logarithmic axis that has all times and the deadline. */
function axisOf(rows, deadline) {
  const all = rows.flatMap(row => [row.p50_ms, row.slowest_ms, row.p99_ms]).concat(deadline).filter(value => value > 0);
  if (!all.length) return null;
  const low = Math.floor(Math.log10(Math.min(...all))), high = Math.max(low + 1, Math.ceil(Math.log10(Math.max(...all))));
  const place = value => 100 * (Math.log10(value) - low) / (high - low);
  return { place, ticks: Array.from({ length: high - low + 1 }, (_, step) => 10 ** (low + step)) };
}

function course(values) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 90 18");
  svg.setAttribute("class", "course");
  svg.setAttribute("aria-hidden", "true");
  const shown = values.filter(value => value !== null), most = Math.max(...shown);
  const line = document.createElementNS(svg.namespaceURI, "polyline");
  const step = 88 / Math.max(1, shown.length - 1);
  line.setAttribute("points", shown.map((value, index) => `${1 + step * index},${17 - 16 * value / most}`).join(" "));
  svg.append(line);
  return svg;
}

function rowOf(row, axis, deadline) {
  const made = element("tr", "", row.state), name = element("th", row.name);
  name.scope = "row";
  const why = row.state === "dropped" ? row.text : row.state === "running" ? `${row.stage}: run ${row.runs + 1}` : "";
  if (why) name.append(element("span", why, "why"));
  const few = (row.slowest_ms ?? null) !== null, slow = few ? row.slowest_ms : row.p99_ms;
  const runs = element("td", "", "wide"), times = element("td", "", "times"), room = element("span", "", "room");
  if (row.course.some(value => value !== null)) runs.append(course(row.course));
  if (axis && row.p50_ms) {
    const bar = element("span", "", "bar"), from = axis.place(row.p50_ms), to = slow ? axis.place(slow) : 100;
    bar.style.left = `${from}%`;
    bar.style.width = `${to - from}%`;
    room.append(bar);
  }
  if (axis && deadline) {
    const due = element("span", "", "due");
    due.style.left = `${axis.place(deadline)}%`;
    room.append(due);
  }
  times.append(room);
  const share = row.messages ? `${(100 * (1 - row.lost / row.messages)).toFixed(1)} %` : "–";
  made.append(name, runs, element("td", share), times, ...[row.p50_ms, slow].map(value => element("td", value === null && row.messages ? "lost" : time(value))));
  if (few) made.lastChild.append(element("span", `slowest of ${row.messages}`, "why"));
  return made;
}

function showAnswer(state) {
  const found = state.answer;
  byId("answer").hidden = !found;
  if (!found) return;
  byId("sentence").textContent = found.sentence;
  byId("proofs").replaceChildren(...found.proofs.map(proof => element("li", `${proof.of} against ${proof.against}: ${proof.verdict}${proof.reason ? ` (${proof.reason})` : ""}`)));
  byId("files").hidden = !found.recommended?.exports.length;
  byId("exports").textContent = (found.recommended?.exports ?? []).join("\n");
  byId("save").download = (found.recommended?.configuration ?? "environment.sh").split("/").pop();
  byId("command").textContent = state.command;
}

let version = "";
async function look() {
  try {
    const answer = await fetch("/state", { headers: version ? { "If-None-Match": version } : {}, cache: "no-store" });
    if (answer.status === 200) {
      version = answer.headers.get("ETag");
      show(await answer.json());
    }
  } catch {
    byId("note").textContent = "The program has ended; what was recorded is kept.";
    return;
  }
  setTimeout(look, 1000);
}

function show(state) {
  for (const row of state.rows) if (!state.running && row.state === "running") row.state = "measured";
  const deadline = state.deadline_ms, axis = axisOf(state.rows, deadline);
  byId("progress").hidden = !state.rows.length && !state.running;
  byId("stop").hidden = !state.running;
  form.querySelector(".primary").disabled = state.running;
  byId("error").textContent = state.error;
  byId("left").textContent = state.running ? `${(state.left_s / 60).toFixed(1)} min left` : "";
  byId("spent").hidden = !state.running;
  byId("spent").value = state.running ? 1 - state.left_s / (60 * (state.question.minutes || 10)) : 1;
  byId("note").textContent = state.note;
  byId("candidates").tBodies[0].replaceChildren(...state.rows.map(row => rowOf(row, axis, deadline)));
  byId("ticks").replaceChildren(...(axis?.ticks ?? []).map(value => {
    const tick = element("span", time(value));
    tick.style.left = `${axis.place(value)}%`;
    return tick;
  }));
  showAnswer(state);
  byId("none").hidden = state.earlier.length > 0;
  byId("earlier").replaceChildren(...state.earlier.map(one => {
    const item = element("li"), again = element("button", "Ask again", "quiet");
    again.type = "button";
    again.setAttribute("aria-label", `Ask again: ${one.name}`);
    again.addEventListener("click", () => fill(one.form));
    item.append(element("strong", one.name), element("span", `: ${one.sentence} `), again);
    return item;
  }));
}

form.addEventListener("input", showDevices);
form.addEventListener("submit", async event => {
  event.preventDefault();
  byId("error").textContent = await post("/ask", Object.fromEntries(new FormData(form)));
});
byId("stop").addEventListener("click", () => post("/stop", {}));
fetch("/machine").then(answer => answer.json()).then(machine => {
  form.link.append(...machine.links.map(name => new Option(name)));
  byId("machine").querySelector("ul").append(...machine.middlewares.map(one => element("li", `${one.works ? "+" : "–"} ${one.name}: ${one.detail}`)));
});
showTheme();
look();
