"use strict";
// Tables sort by a click on a column's head; a printed page shows what is folded. Nothing else needs a script.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = table.tHead.rows[0].cells;
  for (const head of heads) {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const rows = [...table.tBodies[0].rows];
      const text = head.classList.contains("text") || head.cellIndex === 0;
      const old = head.getAttribute("aria-sort");
      const rising = old ? old === "descending" : text;
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", rising ? "ascending" : "descending");
      const value = row => row.cells[head.cellIndex].dataset.v ?? row.cells[head.cellIndex].textContent.trim();
      rows.sort((one, other) => {
        const a = value(one), b = value(other);
        if (text) return (rising ? 1 : -1) * a.localeCompare(b);
        if (a === "" || b === "") return (a === "") - (b === "");
        return (rising ? 1 : -1) * (a - b);
      });
      table.tBodies[0].append(...rows);
    });
  }
}
addEventListener("beforeprint", () => {
  for (const fold of document.querySelectorAll("details:not([open])")) { fold.open = true; fold.dataset.folded = ""; }
});
addEventListener("afterprint", () => {
  for (const fold of document.querySelectorAll("details[data-folded]")) { fold.open = false; delete fold.dataset.folded; }
});
