"use strict";
// Below each result of a search, the text around its first word. A page in a folder cannot be fetched: the texts are a script.
addEventListener("DOMContentLoaded", () => {
  const results = document.getElementById("search-results");
  if (results === null) return;
  const words = (new URLSearchParams(location.search).get("q") || "").toLowerCase().split(/\s+/).filter(Boolean);
  const spelt = words.flatMap((word) => (word === "wifi" ? [word, "wi-fi"] : [word]));

  function excerpt(text) {
    const at = spelt.map((word) => text.toLowerCase().indexOf(word)).find((place) => place >= 0) ?? 0;
    const start = Math.max(0, at - 80);
    return `${start ? "…" : ""}${text.slice(start, at + 160)}…`;
  }

  function show() {
    for (const link of results.querySelectorAll("li > a:first-of-type")) {
      const text = PAGE_TEXTS[link.getAttribute("href").replace(/\.html.*$/, "")];
      if (text === undefined || link.parentElement.querySelector(".excerpt")) continue;
      const part = document.createElement("p");
      part.className = "excerpt";
      part.textContent = excerpt(text);
      link.parentElement.append(part);
    }
  }

  const script = document.createElement("script");
  script.src = "_static/texts.js";
  script.onload = () => { new MutationObserver(show).observe(results, { childList: true, subtree: true }); show(); };
  document.head.append(script);
});
