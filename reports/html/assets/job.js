"use strict";
// "Does it fit my job?": writes the command that answers it. Python alone judges what meets a deadline.
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
  const unique = (key) => [...new Set(DATA.cells.map((cell) => cell[key]))];
  const cell = DATA.cells[shownCell() ?? 0];
  const shares = DATA.percentiles.slice(1).map(({ share }) => [`${share}`, `${percent(share)} %`]);
  form.replaceChildren(
    choice(
      "data",
      "Data ",
      unique("kind").map((kind) => [kind, DATA.cells.find((one) => one.kind === kind).data]),
    ),
    entry("size", "Size ", cell.size, unique("size")),
    entry("rate", "Rate ", cell.rate, unique("rate")),
    entry("deadline", "Deadline ", "50 ms", []),
    choice("reliability", "for ", shares),
    choice("domain", "Domains ", [
      ["", "any"],
      ["same", "same"],
      ["different", "different"],
    ]),
  );
  form.elements.data.value = cell.kind;
  form.elements.reliability.value = "0.99";
  form.addEventListener("input", showJob);
  form.addEventListener("submit", (event) => event.preventDefault());
  showJob();
}

/** Show the command; each value that is typed stays one word, whatever it holds. */
function showJob() {
  const words = [...document.getElementById("job-form").elements]
    .map(({ name, value }) => [name, value.replace(/[^\w.%µ-]/g, "")])
    .filter(([, value]) => value)
    .map(([name, value]) => `--${name} ${value}`);
  document.querySelector("#job-command code").textContent = [DATA.recommend, ...words].join(" ");
}
