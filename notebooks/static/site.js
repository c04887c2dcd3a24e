// A table that is wider than the page scrolls in its own box. The box then says so, and
// can be reached and scrolled with the keyboard.
"use strict";
(() => {
  const HINT = "This table is wider than the window. Scroll it sideways.";

  function look(box) {
    const isWide = box.scrollWidth > box.clientWidth + 1;
    let hint = box.previousElementSibling;
    if (!hint?.classList.contains("scroll-hint")) {
      hint = document.createElement("p");
      hint.className = "scroll-hint";
      hint.textContent = HINT;
      hint.hidden = true;
      box.before(hint);
    }
    hint.hidden = !isWide;
    if (isWide) {
      box.tabIndex = 0;
      box.setAttribute("role", "group"); // no landmark: a page has many
      box.setAttribute("aria-label", "Table, scrolls sideways");
    } else {
      for (const name of ["tabindex", "role", "aria-label"]) box.removeAttribute(name);
    }
  }

  document.addEventListener("DOMContentLoaded", () => {
    const boxes = document.querySelectorAll(".pst-scrollable-table-container, .cell_output .output.text_html");
    const watch = new ResizeObserver((entries) => entries.forEach((entry) => look(entry.target)));
    boxes.forEach((box) => { if (box.querySelector("table")) watch.observe(box); });
    // the theme's buttons that fold out the menu at the side have no name
    for (const button of document.querySelectorAll("summary:has(> .toctree-toggle)")) {
      const link = button.parentElement.parentElement.querySelector("a");
      button.setAttribute("aria-label", `Pages below ${link?.textContent.trim() || "this one"}`);
    }
  });
})();
