// Tiles on the sky, colored by a column, with a slider that selects the passes.

const BINS = 8;

class SkyMapView extends SkyMapDrawing {
  constructor(live, data) {
    super();
    const n = data.n;
    Object.assign(this, { live, data, n, selected: -1, upTo: Infinity, from: -Infinity });
    this.columns = Object.fromEntries(Object.entries(data.columns).map(([name, column]) => [name, unpack(column, n)]));
    this.ra = unpack(data.ra, n);
    this.dec = unpack(data.dec, n);
    this.name = this.columns.tile.map(String);
    this.project = projection(data.whole, ...data.center);
    this.unproject = inverse(data.whole, ...data.center);
    const places = this.ra.map((ra, k) => this.project(ra, this.dec[k]));
    this.x = places.map(([x]) => x);
    this.y = places.map(([, y]) => y);
    this.passes = [...new Set(this.columns.pass)].sort((a, b) => a - b);
    const [[x0, x1], [y0, y1]] = [extent(this.x), extent(this.y)];
    const r = data.radius;
    const box = data.whole ? [-163, -82, 163, 82] : [x0 - r, y0 - r, x1 + r, y1 + r];
    this.stage = new Stage(this, box, { flip: true, label: `Map of ${plural(n, "tile")}, east to the left. Arrow keys select tiles.`,
      keys: "Ctrl with the wheel, two fingers, + and \u2212: zoom. Drag, or Shift with arrow keys: move. 0: show everything. Arrow keys: select a tile. " +
        "A: restrict the table to the visible part. Enter: show the row in the table. Escape: end the selection." });
    if (data.whole) this.stage.frame.classList.add("low");
    this.panel = make("div", { class: "panel", "aria-live": "polite" });
    this.count = make("p", { class: "count", role: "status" });
    this.legend = make("ul", { class: "legend" });
    live.append(this.tools(), make("div", { class: "panes" }, make("div", {}, this.stage.frame, this.legend, this.count, this.stage.help), this.panel), this.tableBox());
    this.colorBy(this.column);
    this.choose(-1);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.update());
  }

  tools() {
    const box = make("div", { class: "tools" });
    const names = Object.keys(this.columns).filter((name) => name !== "tile" && this.columns[name].some(Number.isFinite));
    this.column = names.includes("completeness") && this.data.observed ? "completeness" : "pass";
    const [colors, value] = select("Color", [["", names.map((name) => [name, name.replaceAll("_", " ")])]], (event) => this.colorBy(event.target.value));
    value.value = this.column;
    box.append(colors);
    if (this.passes.length > 1) {
      this.slider = make("input", { type: "range", min: 0, max: this.passes.length - 1, value: this.passes.length - 1, step: 1, "aria-label": "Pass" });
      this.only = make("input", { type: "checkbox", "aria-label": "Only this pass" });
      const update = () => this.setPass(this.passes[+this.slider.value], this.only.checked);
      this.slider.addEventListener("input", update);
      this.only.addEventListener("change", update);
      this.passText = make("output", {});
      box.append(make("label", { class: "field" }, this.passText, this.slider), make("label", { class: "check" }, this.only, " only this pass"));
    }
    box.append(this.searchField());
    return box;
  }

  searchField() {
    const search = make("input", { type: "search", placeholder: "tile, or ra dec", autocomplete: "off", "aria-label": "Search for a tile" });
    return make("form", { class: "field", role: "search", onsubmit: (event) => { event.preventDefault(); this.find(search.value.trim()); } },
      make("label", {}, make("span", {}, "Tile "), search));
  }

  setPass(pass, only) {
    [this.from, this.upTo] = [only ? pass : -Infinity, pass];
    this.slider.setAttribute("aria-valuetext", `pass ${pass}`);
    this.filter();
  }

  colorBy(column) {
    this.column = column;
    const values = this.columns[column].filter(Number.isFinite);
    const [low, high] = extent(values);
    const one = low === high;
    const whole = values.every(Number.isInteger);
    const n = one ? 1 : whole ? Math.min(BINS, high - low + 1) : BINS;
    const each = whole && high - low < BINS;
    const size = one || each ? 1 : (high - low) / n;
    const decimals = whole ? 0 : Math.max(0, 1 - Math.floor(Math.log10(size)));
    const edge = (k) => (whole ? String(Math.ceil(low + size * k - 1e-9)) : (low + size * k).toFixed(decimals));
    this.bin = this.columns[column].map((v) => (Number.isFinite(v) ? Math.min(Math.floor((v - low) / size), n - 1) : -1));
    this.words = Array.from({ length: n }, (_, k) => (one ? String(low) : each ? edge(k) :
      `${edge(k)} to ${whole && k < n - 1 ? edge(k + 1) - 1 : edge(k + 1)}`));
    this.update();
  }

  shown(k) {
    return this.stage.inArea(this.x[k], this.y[k]) && this.columns.pass[k] <= this.upTo && this.columns.pass[k] >= this.from;
  }

  filter() {
    this.update();
    this.table?.show(this.name.map((_, k) => k).filter((k) => this.shown(k)));
  }

  update() {
    const rows = this.name.map((_, k) => k).filter((k) => this.shown(k));
    const missing = rows.filter((k) => this.bin[k] < 0).length;
    this.count.textContent = `Shown: ${rows.length} of ${plural(this.n, "tile")}${missing ? `; ${missing} of them without a value (dashed)` : ""}.`;
    if (this.passText) {
      const last = this.passes[+this.slider.value];
      this.passText.textContent = this.only.checked || last === this.passes[0] ? `Pass ${last}` : `Passes ${this.passes[0]} to ${last}`;
    }
    const unit = this.data.units[this.column];
    fillLegend(this.legend, [[`${this.column.replaceAll("_", " ")}${unit ? ` [${unit}]` : ""}:`, "", "none"],
      ...this.words.map((words, bin) => [words, this.binColor(bin), "dot"]),
      ...(missing ? [[`no value (${missing})`, "var(--c-idle)", "open dot absent"]] : [])]);
    this.stage.draw();
  }

  // ---- selection

  pick(x, y) {
    return nearest(this.x, this.y, x, y, Math.max(this.data.radius * 1.2, 8 / this.stage.scale), (k) => this.shown(k));
  }

  where(x, y) {
    const place = this.unproject(x, y);
    return place ? `ra ${fixed(place[0], 3)}\u00b0, dec ${fixed(place[1], 3)}\u00b0` : "";
  }

  card(k, long = false) {
    const show = (value) => (typeof value === "string" ? value : Number.isInteger(value) ? String(value) : fixed(value, 4));
    const columns = Object.entries(this.columns).filter(([name]) => name !== "tile");
    return [make(long ? "h3" : "p", {}, make("strong", {}, `Tile ${this.name[k]}`)),
      list([["ra", fixed(this.ra[k], 4, "\u00b0")], ["dec", fixed(this.dec[k], 4, "\u00b0")],
        ...columns.map(([name, values]) => [name.replaceAll("_", " "), show(values[k])])]),
      ...(long ? [make("p", {}, make("a", { href: this.aladin(k), target: "_blank", rel: "noreferrer" }, "Open this field in Aladin Lite"),
        ". The link requires a network; the page itself loads nothing.")] : [])];
  }

  aladin(k) {
    const target = encodeURIComponent(`${this.ra[k].toFixed(5)} ${this.dec[k].toFixed(5)}`);
    return `https://aladin.cds.unistra.fr/AladinLite/?target=${target}&fov=${(3 * this.data.radius).toPrecision(3)}`;
  }

  choose(k, show = true) {
    this.selected = k;
    this.panel.replaceChildren(...(k < 0 ? [make("p", {}, "Click a tile, or search for its number, to see its values.")] : this.card(k, true)));
    if (this.details.open) this.table?.mark(k, show);
    this.stage.draw();
  }

  find(text) {
    const place = this.name.includes(text) ? null : coordinates(text);
    const [sin, cos] = [Math.sin, Math.cos].map((f) => f((place?.[1] ?? 0) * RAD));
    const near = this.ra.map((ra, k) => place && sin * Math.sin(this.dec[k] * RAD) + cos * Math.cos(this.dec[k] * RAD) * Math.cos((ra - place[0]) * RAD));
    const k = place ? near.indexOf(extent(near)[1]) : this.name.indexOf(text);
    if (k < 0) return this.panel.replaceChildren(make("p", {}, `No tile has the number ${text}.`));
    this.choose(k);
    if (place) this.panel.prepend(make("p", { class: "why" }, `The center of this tile is closest to the position, at a distance of ${fixed(Math.acos(Math.min(near[k], 1)) / RAD, 3)}\u00b0.`));
    return this.stage.show(this.x[k], this.y[k], 60 / this.data.radius);
  }

  step(dx, dy) { this.stage.step(this.x, this.y, this.selected, dx, dy, (k) => this.shown(k)); }

  // ---- table

  tableBox() {
    const { tile, ...others } = this.columns;
    const columns = Object.entries({ tile, ra: this.ra, dec: this.dec, ...others }).map(([name, values]) => {
      const number = values.every((value) => typeof value === "number");
      const text = (k) => (Number.isNaN(values[k]) ? "" : String(values[k]));
      return { name: name.replaceAll("_", " "), unit: this.data.units[name] ?? { ra: "deg", dec: "deg" }[name] ?? "", text, ...(number && { value: (k) => values[k] }) };
    });
    this.scroll = make("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "All tiles" });
    this.fillTable = () => {
      this.table = new LongTable(this.scroll, columns, { n: this.n, label: "Tile", choose: (k) => this.choose(k, false) });
      this.filter();
      this.table.mark(this.selected, true);
      this.scroll.dispatchEvent(new Event("scroll"));
    };
    this.details = make("details", { ontoggle: () => this.details.open && !this.table && this.fillTable() }, make("summary", {}, "All tiles"),
      this.nights ? make("p", { class: "count" }, "The states are those after the last night.") : "", this.scroll);
    noteHiddenColumns(this.scroll);
    return this.details;
  }

  enter() { openRow(this); }
}
VIEWS.sky_map = SkyMapView;
