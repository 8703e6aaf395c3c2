// A table that can be sorted, and that contains only the rows in the visible part of its scroll region, so that thousands of rows
// open at once. Each column has a name, a unit, and the functions text(k) and value(k), which returns the number in row k; columns
// of text have no function value. A button in the first column selects a row.

const SPARE = 10; // rows above and below the visible part

class LongTable {
  constructor(region, columns, { n, label, choose }) {
    Object.assign(this, { region, columns, n, label, choose, rows: [], order: [], drawn: new Map(), marked: -1, sorting: null });
    const heads = columns.map(({ name, unit, value }) => make("th", { scope: "col", class: value ? "number" : null }, name,
      unit ? " " : "", unit ? make("span", { class: "unit" }, unit) : ""));
    const spacer = () => make("tr", { "aria-hidden": "true" }, make("td", { colspan: columns.length }));
    [this.above, this.below] = [spacer(), spacer()];
    // an invisible row with the longest text of each column keeps the widths of the columns
    const widest = make("tr", {}, ...columns.map((_, c) => this.cell(c, this.longest(c))));
    this.table = make("table", { class: "rows long-table" }, make("thead", {}, make("tr", {}, ...heads)),
      make("tbody", { class: "widest", "aria-hidden": "true" }, widest), make("tbody", {}, this.above, this.below));
    makeSortable(this.table, (column, sign) => { this.sorting = [column, sign]; this.sort(); });
    region.replaceChildren(this.table);
    region.onscroll = () => this.draw();
    region.onkeydown = (event) => this.key(event);
  }

  // Arrow keys select the next row; the buttons of rows are not in the order of the Tab key, so that Tab leaves the table.
  key(event) {
    const { order } = this, step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -Infinity, End: Infinity }[event.key];
    if (event.key === "Escape") this.region.closest("details").querySelector("summary").focus();
    if (!step || !order.length) return;
    event.preventDefault();
    const k = order[Math.max(0, Math.min(order.indexOf(this.marked) + step, order.length - 1))];
    this.choose(k);
    this.mark(k, true).querySelector("button").focus({ preventScroll: true });
  }

  csv() {
    const lines = this.order.map((k) => this.columns.map(({ text, value }) => (value ? String(value(k)).replace("NaN", "") : text(k))));
    lines.unshift(this.columns.map(({ name, unit }) => (unit ? `${name} [${unit}]` : name)));
    return lines.map((line) => `${line.map((text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text)).join(",")}\n`).join("");
  }

  longest(column) {
    const { text } = this.columns[column];
    let [best, length] = [0, 0];
    for (let k = 0; k < this.n; k += 1) {
      const own = text(k).length;
      if (own > length) [best, length] = [k, own];
    }
    return best;
  }

  show(rows) {
    this.rows = rows;
    this.table.setAttribute("aria-rowcount", rows.length + 1);
    this.sort();
  }

  sort() {
    this.order = this.rows;
    if (this.sorting) {
      const [column, sign] = this.sorting;
      const { text, value } = this.columns[column];
      const keys = value ? this.rows.map((k) => (Number.isNaN(value(k)) ? null : value(k))) : sortingKeys(this.rows.map((k) => text(k) || null));
      const order = keys.map((key, i) => [key, this.rows[i]]);
      this.order = this.rows = order.sort(([a], [b]) => compareKeys(a, b, sign)).map(([, k]) => k);
    }
    for (const row of this.drawn.values()) row.remove();
    this.drawn.clear();
    this.region.scrollTop = 0;
    this.draw();
  }

  cell(column, k) {
    const { text, value } = this.columns[column];
    const words = text(k);
    if (column === 0) return make("th", { scope: "row" }, make("button", { type: "button", tabindex: -1, "aria-label": `${this.label} ${words}: select` }, words));
    const missing = words === "" || words === "\u2013";
    return make("td", { class: [value && "number", missing && "missing"].filter(Boolean).join(" ") || null }, missing ? "\u2013" : words);
  }

  // Rows that remain visible are not replaced, so that they keep the focus.
  draw() {
    const { region, order, drawn } = this;
    const height = this.height ?? 36;
    const first = Math.max(0, Math.floor(region.scrollTop / height) - SPARE);
    const end = Math.min(order.length, Math.ceil((region.scrollTop + region.clientHeight) / height) + SPARE);
    for (const [i, row] of drawn) {
      if (i >= first && i < end) continue;
      row.remove();
      drawn.delete(i);
    }
    let next = this.below;
    for (let i = end - 1; i >= first; i -= 1) {
      if (!drawn.has(i)) {
        const k = order[i];
        const row = make("tr", { "aria-rowindex": i + 2, "aria-selected": k === this.marked ? "true" : null, onclick: () => this.choose(k) },
          ...this.columns.map((_, c) => this.cell(c, k)));
        drawn.set(i, row);
        next.before(row);
      }
      next = drawn.get(i);
    }
    this.above.cells[0].style.height = `${first * height}px`;
    this.below.cells[0].style.height = `${(order.length - end) * height}px`;
    for (const [spacer, size] of [[this.above, first], [this.below, order.length - end]]) spacer.hidden = size <= 0;
    if (this.height || !drawn.size || !region.clientHeight) return;
    this.height = next.getBoundingClientRect().height;
    this.draw();
  }

  // Mark a row, and scroll to it if `show` is true; return the row, or undefined if the table does not contain it.
  mark(k, show) {
    this.marked = k;
    const at = this.order.indexOf(k);
    if (show && at >= 0) {
      this.region.scrollTop = at * (this.height ?? 36) - this.region.clientHeight / 2;
      this.draw();
    }
    for (const [i, row] of this.drawn) {
      if (i === at) row.setAttribute("aria-selected", "true");
      else row.removeAttribute("aria-selected");
    }
    return this.drawn.get(at);
  }
}

// Open the table of a view, and move the focus to the row of the selected item.
function openRow(view) {
  if (view.selected < 0) return;
  view.details.open = true;
  if (!view.table) view.fillTable();
  view.table.mark(view.selected, true)?.querySelector("button").focus();
}
