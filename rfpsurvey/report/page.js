"use strict";
// A click or the Enter key on the name of a column sorts the table. Missing values are last in both directions.
const words = new Intl.Collator(undefined, { numeric: true });

function keysOf(body, column) {
  const keys = Array.from(body.rows, (row) => {
    const cell = row.cells[column];
    return cell.classList.contains("missing") ? null : cell.dataset.value ?? cell.textContent;
  });
  const numbers = keys.map((key) => (key === null || key.trim() === "" ? null : Number(key)));
  return numbers.some(Number.isNaN) ? keys : numbers;
}

function sort(table, column, sign) {
  const body = table.tBodies[0];
  const keys = keysOf(body, column);
  const order = Array.from(body.rows, (row, k) => [keys[k], row]);
  order.sort(([a], [b]) => {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a === "string") return sign * words.compare(a, b);
    return a === b ? 0 : sign * (a < b ? -1 : 1);
  });
  body.append(...order.map(([, row]) => row));
}

function makeSortable(table) {
  if (table.tBodies[0].rows.length < 2) return;
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
      sort(table, column, up ? 1 : -1);
    });
  });
}

for (const table of document.querySelectorAll("table.rows")) makeSortable(table);

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
