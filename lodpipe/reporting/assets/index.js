"use strict";
// The folder's page: search, filter and sort over rows that are all there already.
(() => {
  const body = document.querySelector("#assets tbody");
  const rows = [...body.rows].map((row) => ({ row, words: row.cells[1].textContent.toLowerCase() }));
  const search = document.getElementById("search");

  function choose() {
    const wanted = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const outcome = document.querySelector("input[name=outcome]:checked").value;
    let found = 0;
    for (const { row, words } of rows) {
      row.hidden = !((!outcome || row.dataset.outcome === outcome) && wanted.every((word) => words.includes(word)));
      found += !row.hidden;
    }
    document.getElementById("found").textContent = found === rows.length ? "" : `${found} of ${rows.length}`;
  }

  // what a cell is sorted by: its number, nothing being less than any
  function value(cell, kind) {
    if (kind === "text") return cell.textContent.trim().toLowerCase();
    const number = parseFloat(cell.dataset.value ?? cell.textContent.replaceAll(",", ""));
    return Number.isNaN(number) ? -Infinity : number;
  }

  function sort(head) {
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const { cellIndex } = head, { kind } = head.dataset;
    const keyed = rows.map(({ row }) => [value(row.cells[cellIndex], kind), row]);
    keyed.sort(([a], [b]) => (a < b ? -1 : a > b ? 1 : 0) * (up ? 1 : -1));
    body.append(...keyed.map(([, row]) => row));
  }

  for (const head of document.querySelectorAll("#assets thead th[data-kind]")) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    head.addEventListener("click", () => sort(head));
  }
  search.addEventListener("input", choose);
  for (const input of document.querySelectorAll("input[name=outcome]")) input.addEventListener("change", choose);
  document.getElementById("tools").hidden = false;
  choose();
})();
