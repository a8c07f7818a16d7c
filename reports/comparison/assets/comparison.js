"use strict";
// The theme is the system's until the reader chooses one; paper is light.
const root = document.documentElement;
const systemDark = matchMedia("(prefers-color-scheme: dark)");
const button = document.getElementById("theme");
let chosen = "";

function show(name) {
  root.dataset.theme = name;
  button.textContent = name === "dark" ? "Light" : "Dark";
  button.setAttribute("aria-pressed", String(name === "dark"));
}

function current() {
  return chosen || (systemDark.matches ? "dark" : "light");
}

button.addEventListener("click", () => {
  chosen = current() === "dark" ? "light" : "dark";
  show(chosen);
});
systemDark.addEventListener("change", () => show(current()));
addEventListener("beforeprint", () => show("light"));
addEventListener("afterprint", () => show(current()));
show(current());
