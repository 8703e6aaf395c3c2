"use strict";
// A click or the Enter key on the name of a column sorts the table. Missing values are last in both directions.
const words = new Intl.Collator(undefined, { numeric: true });

// The sorting keys of texts: numbers, if all texts are numbers. Null stands for a missing value.
function sortingKeys(texts) {
  const numbers = texts.map((text) => (text === null || text.trim() === "" ? null : Number(text)));
  return numbers.some(Number.isNaN) ? texts : numbers;
}

function compareKeys(a, b, sign) {
  if (a === null || b === null) return (a === null) - (b === null);
  if (typeof a === "string") return sign * words.compare(a, b);
  return a === b ? 0 : sign * (a < b ? -1 : 1);
}

function sort(table, column, sign) {
  const body = table.tBodies[0];
  const rows = Array.from(body.rows);
  const keys = sortingKeys(rows.map((row) => {
    const cell = row.cells[column];
    return cell.classList.contains("missing") ? null : cell.dataset.value ?? cell.textContent;
  }));
  const order = rows.map((row, k) => [keys[k], row]);
  order.sort(([a], [b]) => compareKeys(a, b, sign));
  body.append(...order.map(([, row]) => row));
}

// `apply` sorts the table by a column; the sign is 1 or, for descending order, -1.
function makeSortable(table, apply) {
  const heads = Array.from(table.tHead.rows[0].cells);
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    head.setAttribute("aria-sort", "none");
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const other of heads) other.setAttribute("aria-sort", "none");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      apply(column, up ? 1 : -1);
    });
  });
}

for (const table of document.querySelectorAll("table.rows")) {
  if (table.tBodies[0].rows.length > 1) makeSortable(table, (column, sign) => sort(table, column, sign));
}

// If an element is wider than the page, a text above the element states how many columns are hidden to the right.
function noteHiddenColumns(region) {
  const more = document.createElement("p");
  more.className = "more";
  region.before(more);
  const update = () => {
    const edge = region.getBoundingClientRect().right + 1;
    const heads = Array.from(region.querySelectorAll("thead th"));
    const hidden = heads.filter((head) => head.getBoundingClientRect().right > edge).length;
    const wide = region.scrollWidth > region.clientWidth + 1;
    const what = heads.length === 0 ? "more" : `${hidden} more column${hidden === 1 ? "" : "s"}`;
    const end = region.scrollLeft + region.clientWidth >= region.scrollWidth - 1;
    more.hidden = !wide;
    more.textContent = end ? "\u2190 scroll back" : `${what}: scroll sideways \u2192`;
  };
  region.addEventListener("scroll", update, { passive: true });
  region.closest("details")?.addEventListener("toggle", update);
  addEventListener("resize", update);
  update();
}

for (const region of document.querySelectorAll(".scroll")) noteHiddenColumns(region);

// Closed tables are open on paper.
addEventListener("beforeprint", () => document.querySelectorAll("main details:not(.live *)").forEach((one) => { one.open = true; }));
