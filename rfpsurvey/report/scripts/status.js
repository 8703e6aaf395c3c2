// The nights of a survey: tiles by state, the calendar, the completeness of classes, and the fibers of a tile.

// Colors and symbols of the states of tiles; the colors are those of plot/_classes.py, or darker ones.
const TILE_STATES = {
  planned: ["c-planned", "ring"], dropped: ["c-obstacle", "open dot absent"], past: ["c-idle", "open dot"], observed: ["c-arm", "dot"],
  "partly observed": ["c-good", "dot"], bad: ["c-collision", "dot"],
};
const FIBERS = ["idle", "science", "standard", "sky", "collision"]; // names in STATES, by the codes of fibers
const KINDS = ["other", "first", "second"]; // names in CHANGES, by the codes of changes
const LINES = ["ink", "c-collision", "c-arm", "c-star", "c-good", "c-other", "c-planned", "c-idle"]; // as in plot_survey_status
const DASHES = ["", "6 3", "2 3", "8 3 2 3", "4 2", "1 4", "10 4", "3 6"];
const DAY = 86400000;

class StatusView extends SkyMapView {
  // The constructor of the class of maps calls the methods tools, colorBy and choose.
  tools() {
    const { data } = this;
    this.nights = data.nights;
    this.night = this.nights.length;
    this.words = Object.keys(TILE_STATES);
    this.codes = data.states.map((own) => own.map(([night, code]) => [night, this.words.indexOf(data.names[code])]));
    this.ofNight = Array.from({ length: this.nights.length + 1 }, () => ({ tiles: {}, failures: 0 }));
    for (const [, night, code] of data.attempts) this.ofNight[night].tiles[data.names[code]] = (this.ofNight[night].tiles[data.names[code]] ?? 0) + 1;
    for (const [, night] of data.failures) this.ofNight[night].failures += 1;
    this.slider = make("input", { type: "range", min: 0, max: this.nights.length, value: this.night, step: 1, "aria-label": "Night",
      oninput: () => this.setNight(+this.slider.value) });
    this.nightText = make("output", {});
    const step = (text, name, by) => make("button", { type: "button", "aria-label": name, title: name, onclick: () => this.setNight(this.night + by) }, text);
    const tools = make("div", { class: "tools" }, make("label", { class: "field wide" }, this.nightText, this.slider),
      step("\u2190", "Previous night", -1), step("\u2192", "Next night", 1), this.searchField());
    return make("div", {}, tools, this.calendar());
  }

  colorBy() {
    const { live, data } = this;
    this.fibers = new FiberMap(this, data);
    this.curves = make("div", { class: "curves" });
    live.append(make("h3", {}, "Focal plane"), this.fibers.box, make("h3", {}, "Completeness"), this.curves);
    this.plotCurves();
    this.setNight(this.night);
  }

  setNight(night) {
    this.night = Math.max(0, Math.min(night, this.nights.length));
    this.slider.value = this.night;
    this.update();
    this.fibers.update();
    if (this.selected >= 0) this.panel.replaceChildren(...this.card(this.selected, true));
    this.markNight();
  }

  update() {
    this.bin = this.codes.map((own) => own.reduce((last, [night, code]) => (night <= this.night ? code : last), 0));
    const counts = this.words.map((_, code) => this.bin.filter((bin, k) => bin === code && this.shown(k)).length);
    const date = this.nights[this.night - 1];
    this.nightText.textContent = date ? `Night ${this.night} of ${this.nights.length}: ${date}` : this.nights.length ? "Before the first night" : "No night has a date";
    this.slider.setAttribute("aria-valuetext", this.nightText.textContent);
    this.count.textContent = `${counts[this.words.indexOf("observed")]} of ${plural(this.n, "tile")} observed.`;
    fillLegend(this.legend, this.words.map((word, k) => [`${word} (${counts[k]})`, `var(--${TILE_STATES[word][0]})`, TILE_STATES[word][1]])
      .filter((_, k) => counts[k]));
    this.stage.draw();
  }

  binColor(bin) { return this.stage.color(TILE_STATES[this.words[bin]][0]); }

  isOpen(rows) { return rows.length > 0 && TILE_STATES[this.words[this.bin[rows[0]]]][1] !== "dot"; }

  paintFields(context, stage, rows) {
    if (!this.isOpen(rows)) return super.paintFields(context, stage, rows);
    for (const k of rows) this.pathOf(context, stage, k);
    context.lineWidth = 1.5;
    context.setLineDash(TILE_STATES[this.words[this.bin[rows[0]]]][1].includes("absent") ? [5, 4] : []);
    context.stroke();
    return context.setLineDash([]);
  }

  paintDisks(context, stage, rows, r) {
    if (!this.isOpen(rows)) super.paintDisks(context, stage, rows, r);
  }

  paintSquares(context, stage, rows, r, hollow = this.isOpen(rows)) {
    context.lineWidth = 1;
    super.paintSquares(context, stage, rows, r, hollow);
    if (hollow) context.stroke();
  }

  card(k, long = false) {
    const [head, ...values] = super.card(k, long);
    const when = this.night ? `after ${this.nights[this.night - 1]}` : "before the first night";
    return [head, make("p", { class: "why" }, `State ${when}: ${this.words[this.bin[k]]}`), ...values];
  }

  choose(k, show = true) {
    super.choose(k, show);
    this.fibers.setTile(k);
  }

  // ---- calendar: a line for each month, and a cell for each day

  dayText(night) {
    const { tiles, failures } = this.ofNight[night];
    return [...Object.entries(tiles).map(([word, n]) => `${plural(n, "tile")} ${word}`), ...(failures ? [`${plural(failures, "failed visit")}`] : [])].join(", ");
  }

  calendar() {
    this.days = [];
    const months = new Map();
    this.nights.forEach((date, k) => months.set(date.slice(0, 7), [...(months.get(date.slice(0, 7)) ?? []), k + 1]));
    const lines = [...months].map(([month, nights]) => {
      const line = make("div", { class: "month" }, make("span", {}, month));
      const days = new Date(Date.UTC(+month.slice(0, 4), +month.slice(5, 7), 0)).getUTCDate();
      for (let day = 1; day <= days; day += 1) {
        const night = nights.find((one) => +this.nights[one - 1].slice(8) === day);
        if (night === undefined) { line.append(make("span", { class: "day" })); continue; }
        const counts = Object.entries(this.ofNight[night].tiles);
        const total = counts.reduce((sum, [, n]) => sum + n, 0);
        const cell = make("button", { type: "button", class: "day", tabindex: -1, title: `${this.nights[night - 1]}: ${this.dayText(night)}`,
          "aria-label": `${this.nights[night - 1]}: ${this.dayText(night)}`, onclick: () => this.setNight(night) }, total ? String(total) : "");
        let from = 0;
        const parts = counts.map(([word, n]) => {
          const part = `var(--${TILE_STATES[word][0]}) ${100 * from / total}% ${100 * (from + n) / total}%`;
          from += n;
          return part;
        });
        if (parts.length) cell.style.background = `linear-gradient(to right, ${parts.join(", ")})`;
        this.days[night] = cell;
        line.append(cell);
      }
      return line;
    });
    return make("div", {}, make("div", { class: "calendar", role: "group", "aria-label": "Calendar of the nights" }, ...lines),
      make("p", { class: "keys note" }, "Each line is a month. A number is the number of tiles of a night, and a color is their state; gray nights have none. A click selects the night."));
  }

  // The selected night in the calendar and in the plot of the completeness.
  markNight() {
    this.marked?.removeAttribute("aria-current");
    this.marked?.setAttribute("tabindex", -1);
    this.marked = this.days[this.night] ?? null;
    this.marked?.setAttribute("aria-current", "date");
    this.marked?.setAttribute("tabindex", 0);
    const [top, box] = [this.marked?.offsetTop ?? 0, this.marked?.closest(".calendar")];
    if (box && (top < box.scrollTop || top > box.scrollTop + box.clientHeight - 40)) box.scrollTop = top - box.clientHeight / 2;
    const x = this.place(this.night);
    for (const name of ["x1", "x2"]) this.cursor.setAttribute(name, x);
    this.values.forEach((cell, k) => {
      const [, n, seen] = this.data.classes[k];
      cell.textContent = `${seen[this.night]} of ${n} (${fixed(n ? seen[this.night] / n : NaN, 3)})`;
    });
  }

  // ---- completeness

  place(night) {
    const days = this.nights.map((date) => Date.parse(date) / DAY);
    return night ? 2 + 98 * (days[night - 1] - days[0] + 1) / (days.at(-1) - days[0] + 1) : 0;
  }

  plotCurves() {
    const { classes } = this.data;
    const svg = (tag, attributes) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
      for (const [name, value] of Object.entries({ fill: "none", "vector-effect": "non-scaling-stroke", ...attributes })) element.setAttribute(name, value);
      return element;
    };
    const plot = svg("svg", { viewBox: "0 0 100 100", preserveAspectRatio: "none", class: "curve", role: "img", "aria-label": "Completeness of each class after each night" });
    const xs = [0, ...this.nights.map((_, k) => this.place(k + 1))];
    for (const y of [0, 25, 50, 75, 100]) plot.append(svg("line", { x1: 0, x2: 100, y1: y, y2: y, stroke: "var(--faint)" }));
    const key = (k) => ({ stroke: `var(--${LINES[k % LINES.length]})`, "stroke-dasharray": DASHES[k % DASHES.length], "stroke-width": k ? 1.5 : 2.5 });
    classes.forEach(([, n, seen], k) => {
      const at = (night) => 100 - 100 * seen[night] / (n || 1);
      plot.append(svg("path", { ...key(k), d: xs.map((x, night) => (night ? `H${x}V${at(night)}` : `M0 ${at(0)}`)).join("") }));
    });
    this.cursor = plot.appendChild(svg("line", { y1: 0, y2: 100, stroke: "var(--c-mark)" }));
    plot.addEventListener("click", (event) => {
      const box = plot.getBoundingClientRect();
      const x = 100 * (event.clientX - box.left) / box.width;
      this.setNight(xs.reduce((best, one, k) => (Math.abs(one - x) < Math.abs(xs[best] - x) ? k : best), 0));
    });
    this.values = classes.map(() => make("td", { class: "number" }));
    const rows = classes.map(([name], k) => {
      const line = svg("svg", { viewBox: "0 0 30 6", class: "key", "aria-hidden": "true" });
      line.append(svg("line", { x1: 0, x2: 30, y1: 3, y2: 3, ...key(k) }));
      return make("tr", {}, make("th", { scope: "row" }, line, name), this.values[k]);
    });
    const [first, last] = [this.nights[0] ?? "", this.nights.at(-1) ?? ""];
    this.curves.append(make("div", { class: "panes" },
      make("div", { class: "axes" }, make("div", { class: "scale", "aria-hidden": "true" }, make("span", {}, "1"), make("span", {}, "0.5"), make("span", {}, "0")),
        plot, make("div", { class: "ends", "aria-hidden": "true" }, make("span", {}, first), make("span", {}, last))),
      make("table", { class: "facts" }, make("caption", {}, "Observed of the requested visits, up to the selected night"), make("tbody", {}, ...rows))));
  }

}
VIEWS.status = StatusView;

// The focal plane: the fibers of a tile, its changed fibers, or the failed visits of all tiles up to the selected night.
class FiberMap extends FocalPlaneDrawing {
  constructor(owner, data) {
    super();
    const { id, x, y, outer } = data.positioner;
    Object.assign(this, { owner, source: data, id, n: id.length, tile: -1, selected: -1, found: [], obstacles: [] });
    [this.x, this.y, this.outer] = [unpack(x, this.n), unpack(y, this.n), Array(this.n).fill(outer)];
    this.visible = Array(this.n).fill(true);
    this.data = { obstacles: [], polygons: [], position_angle: null };
    this.angle = owner.columns.position_angle;
    const placed = this.id.map((_, k) => k).filter((k) => Number.isFinite(this.x[k]));
    const [[x0, x1], [y0, y1]] = placed.length ? [this.x, this.y].map((values) => extent(placed.map((k) => values[k]))) : [[-1, 1], [-1, 1]];
    this.stage = new Stage(this, [x0 - outer, y0 - outer, x1 + outer, y1 + outer], { flip: true, label: `Focal plane with ${plural(this.n, "positioner")}. Arrow keys select positioners.`,
      keys: placed.length ? "Arrow keys: select a positioner. Escape: end the selection." : "The folder of the survey does not describe the instrument, so that positions of positioners are not known." });
    this.panel = make("div", { class: "panel", "aria-live": "polite" });
    this.legend = make("ul", { class: "legend" });
    this.count = make("p", { class: "count", role: "status" });
    const [field, box] = select("Show", [["", [["failures", "failed visits of all tiles"], ["fibers", "fibers of the tile"], ["changes", `fibers ${data.plan}`]]]],
      () => this.setMode(box.value));
    this.modeBox = box;
    this.scroll = make("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Changed fibers" });
    this.changedBox = make("details", { hidden: true }, make("summary", {}, "Changed fibers of the tile"), this.scroll);
    this.box = make("div", {}, make("div", { class: "tools" }, field),
      make("div", { class: "panes" }, make("div", {}, this.stage.frame, this.legend, this.count, this.stage.help), this.panel), this.changedBox);
    this.mode = "failures";
  }

  setMode(mode) {
    this.mode = this.modeBox.value = this.tile < 0 ? "failures" : mode;
    this.update();
  }

  setTile(k) {
    const { source } = this;
    this.tile = k;
    this.data.position_angle = k < 0 ? null : this.angle[k];
    const expand = (texts, names) => {
      const codes = Array.from({ length: this.n }, (_, i) => parseInt(texts?.[k]?.[i] ?? "0", 36));
      let next = 0;
      return [codes, codes.map((code) => (code ? names?.[k]?.[next++] ?? "" : ""))];
    };
    [this.codes, this.targets] = expand(source.fibers, source.targets);
    [this.changes, this.former] = expand(source.changes, source.former);
    const changed = this.id.map((_, i) => i).filter((i) => this.changes[i]);
    this.changedBox.hidden = !changed.length;
    const columns = [["positioner", (i) => this.id[i]], ["before", (i) => this.former[i]], ["after", (i) => this.targets[i]],
      ["reason", (i) => this.reason(i)]].map(([name, text]) => ({ name, unit: "", text }));
    this.table = new LongTable(this.scroll, columns, { n: this.n, label: "Positioner", choose: (i) => this.choose(i) });
    this.table.show(changed);
    this.choose(-1);
    this.setMode(k < 0 ? "failures" : this.mode === "failures" ? "fibers" : this.mode);
  }

  get hasNames() { return Boolean(this.source.targets[this.tile]); }

  reason(i) { return this.source.reasons[Math.floor((this.changes[i] - 1) / 3)] ?? ""; }

  change(i) { return this.changes[i] ? KINDS[(this.changes[i] - 1) % 3] : "same"; }

  // The failed visits up to the selected night of all tiles or, for the fibers of a tile, of this tile.
  update() {
    if (!this.codes) return;
    const { mode, tile, owner } = this;
    this.failed = this.id.map(() => []);
    for (const one of this.source.failures) if (one[1] <= owner.night && (mode === "failures" || one[0] === tile)) this.failed[one[2]].push(one);
    const most = this.failed.reduce((best, own) => Math.max(best, own.length), 0);
    const state = (i) => STATES[FIBERS[this.codes[i]]];
    this.looks = this.id.map((_, i) => (mode === "failures" ? [this.failed[i].length ? "c-collision" : "c-idle", this.failed[i].length ? "dot" : "ring"] :
      mode === "fibers" ? [state(i)[1], state(i)[2] ?? "dot"] : [CHANGES[this.change(i)][1], this.codes[i] ? "dot" : "ring"]));
    const total = this.failed.reduce((sum, own) => sum + own.length, 0);
    const changed = this.changes.filter(Boolean).length;
    const counted = (entries, test) => entries.map((entry, k) => [entry, this.id.filter((_, i) => test(i, k)).length]).filter(([, n]) => n);
    const names = { ...CHANGES, first: ["target only before", "c-arm"], second: ["target only after", "c-other"] };
    const entries = mode === "failures" ? [["positioner with failed visits; its area shows their number", "c-collision", "dot"], ["no failed visit", "c-idle", "ring"]] :
      mode === "fibers" ? counted(FIBERS, (i, k) => this.codes[i] === k).map(([name, n]) => [`${STATES[name][0]} (${n})`, STATES[name][1], STATES[name][2] ?? "dot"]) :
        counted(["same", ...KINDS], (i, k) => (this.change(i) === ["same", ...KINDS][k])).map(([kind, n]) => [`${names[kind][0]} (${n})`, names[kind][1], kind === "first" ? "ring" : "dot"]);
    if (mode === "fibers" && total) entries.push([`failed visit (${total})`, "c-collision", "cross"]);
    if (mode === "fibers" && changed) entries.push([`changed (${changed})`, "c-mark", "ring"]);
    fillLegend(this.legend, entries.map(([name, color, shape]) => [name, `var(--${color})`, shape]));
    this.count.textContent = mode === "failures" ? `${plural(total, "failed visit")} of all tiles up to the selected night; at most ${most} of a positioner.` :
      `Tile ${owner.name[tile]}: ${plural(changed, "fiber")} ${this.source.plan}; ${plural(total, "failed visit")} up to the selected night.` +
      (this.hasNames || !this.source.fibers[tile] ? "" : " The page does not contain the identifiers of the targets of this tile.");
    if (this.selected >= 0) this.choose(this.selected);
    this.stage.draw();
  }

  colorName(i) { return this.looks[i][0]; }

  symbol(i) { return this.looks[i][1]; }

  paint(context, stage) {
    if (!this.codes) return;
    this.plan = { target_id: this.targets, free: new Map() };
    super.paint(context, stage);
    if (this.mode !== "fibers") return;
    for (const [color, test, draw] of [
      ["c-mark", (i) => this.changes[i], (px, py) => { context.moveTo(px + 6, py); context.arc(px, py, 6, 0, 2 * Math.PI); }],
      ["c-collision", (i) => this.failed[i].length, (px, py) => { for (const s of [-1, 1]) { context.moveTo(px - 5, py - 5 * s); context.lineTo(px + 5, py + 5 * s); } }],
    ]) {
      context.strokeStyle = stage.color(color);
      context.lineWidth = 1.5;
      context.beginPath();
      for (let i = 0; i < this.n; i += 1) if (test(i) && Number.isFinite(this.x[i])) draw(...stage.toScreen(this.x[i], this.y[i]));
      context.stroke();
    }
  }

  // No arms are drawn; the area of a dot is proportional to the number of failed visits.
  paintArms(context, stage, rows) { this.paintDots(context, stage, rows); }

  paintDots(context, stage, rows) {
    if (this.mode !== "failures") return super.paintDots(context, stage, rows);
    const groups = new Map();
    for (const i of rows) groups.set(this.failed[i].length, [...(groups.get(this.failed[i].length) ?? []), i]);
    for (const [number, members] of groups) this.paintSymbols(context, stage, members, this.plan, (i) => [this.x[i], this.y[i]], number ? 2.5 * Math.sqrt(number) : 1.6);
    return undefined;
  }

  // ---- selection

  pick(x, y) {
    return nearest(this.x, this.y, x, y, Math.max(this.outer[0], 10 / this.stage.scale));
  }

  where(x, y) { return `x ${fixed(x, 2)}, y ${fixed(y, 2)} mm`; }

  card(i, long = false) {
    const own = this.failed[i].map(([tile, night, , reason]) => `${this.owner.nights[night - 1] ?? "no date"}, tile ${this.owner.name[tile]}: ${reason || "no reason given"}`);
    const most = long ? 30 : 4;
    const entries = this.tile < 0 ? [] : [["Fiber", STATES[FIBERS[this.codes[i]]][0]], ["Target", this.targets[i]],
      ...(this.changes[i] ? [["Former target", this.former[i]], ["Reason of the change", this.reason(i)]] : [])];
    return [make(long ? "h3" : "p", {}, make("strong", {}, `Positioner ${this.id[i]}`)), list(entries), make("p", { class: "why" }, plural(own.length, "failed visit")),
      ...own.slice(0, most).map((text) => make("p", {}, text)), ...(own.length > most ? [make("p", {}, `and ${own.length - most} more`)] : [])];
  }

  choose(i) {
    this.selected = i;
    this.panel.replaceChildren(...(i < 0 ? [make("p", {}, "Click a tile of the map to see its fibers, and a positioner to see its failed visits.")] : this.card(i, true)));
    this.table?.mark(i, false);
    this.stage.draw();
  }

  step(dx, dy) { this.stage.step(this.x, this.y, this.selected, dx, dy); }
}
