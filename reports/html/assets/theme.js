"use strict";
// Theme: the reader's system decides until the button is pressed; what was chosen is remembered.

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  document.getElementById("theme").textContent = name === "dark" ? "Light theme" : "Dark theme";
}

/** A page on file:// may not store it; then the system's theme applies at the next opening. */
function remembered(name) {
  try {
    if (name) localStorage.setItem("dds-trace-theme", name);
    return localStorage.getItem("dds-trace-theme");
  } catch {
    return null;
  }
}

const systemDark = matchMedia("(prefers-color-scheme: dark)");
let themeChosen = remembered();
function showTheme() {
  setTheme(["dark", "light"].includes(themeChosen) ? themeChosen : systemDark.matches ? "dark" : "light");
  dispatchEvent(new Event("theme"));
}
document.getElementById("theme").addEventListener("click", () => {
  themeChosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  remembered(themeChosen);
  showTheme();
});
systemDark.addEventListener("change", showTheme);
