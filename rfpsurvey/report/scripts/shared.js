// Functions and classes that all interactive views use. Data are inserted into the page as text nodes, never as HTML.

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

// Return the values of a column that report/_pack.py packed: numbers, with NaN for missing values, or texts.
function unpack(column, n) {
  const scale = 10 ** (column.d ?? 0);
  const value = (v) => column.names ? column.names[v] : typeof v === "string" ? v : v === null ? NaN : v / scale;
  if ("c" in column) return Array(n).fill(value(column.c));
  return column.v.map(value);
}

function fixed(value, decimals, unit = "") {
  return Number.isFinite(value) ? value.toFixed(decimals).replace("-", "\u2212") + unit : "\u2013";
}

function plural(n, one, many = `${one}s`) {
  return `${n} ${n === 1 ? one : many}`;
}

function select(label, groups, onchange) {
  const box = make("select", { "aria-label": label, onchange });
  for (const [name, options] of groups) {
    const parent = name ? box.appendChild(make("optgroup", { label: name })) : box;
    for (const [value, text] of options) parent.append(make("option", { value }, text));
  }
  return [make("label", { class: "field" }, make("span", {}, label), box), box];
}

function list(entries) {
  return make("dl", {}, ...entries.filter(([, value]) => value !== "" && value !== null)
    .map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))));
}

// Right ascension and declination (degrees) in a text such as "95.1 +23.2", "06:20:24 +23:12:00" or "6h20m24s +23d12m", or null.
function coordinates(text) {
  const values = text.split(/[\s,]+/).map((part, k) => {
    const [degrees, minutes = 0, seconds = 0, ...more] = part.replace(/^[+\-\u2212]/, "").split(/[:hdms\u00b0'"]+/).filter(Boolean).map(Number);
    const size = (degrees + minutes / 60 + seconds / 3600) * (k === 0 && /[:h]/.test(part) ? 15 : 1);
    return more.length ? NaN : /^[\-\u2212]/.test(part) ? -size : size;
  });
  return values.length === 2 && values.every(Number.isFinite) && Math.abs(values[1]) <= 90 ? values : null;
}

function extent(values) {
  return values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
}

// The index of the point that is closest to (x, y), and closer than a limit, or -1.
function nearest(xs, ys, x, y, least = Infinity, allowed = () => true) {
  let best = -1;
  for (let k = 0; k < xs.length; k += 1) {
    const distance = Math.hypot(xs[k] - x, ys[k] - y);
    if (distance < least && allowed(k)) [best, least] = [k, distance];
  }
  return best;
}

// Entries of a legend: text, color, and shape, which is a class of the style sheet.
function fillLegend(box, entries) {
  box.replaceChildren(...entries.map(([text, color, shape]) => {
    const mark = make("span", { class: `mark ${shape}`, "aria-hidden": "true" });
    mark.style.setProperty("--color", color);
    return make("li", {}, mark, text);
  }));
}

// The largest of the numbers 1, 2, 5, 10, 20, ... that is not above a size.
function niceStep(size) {
  const power = 10 ** Math.floor(Math.log10(size) + 1e-9);
  return power * [5, 2, 1].find((factor) => factor * power <= size * 1.001);
}

// Text that remains legible above other drawings.
function label(context, stage, text, x, y) {
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = stage.color("c-field");
  context.strokeText(text, x, y);
  context.fillText(text, x, y);
}

// Lines toward the directions, which are given by name as [right, up] on the screen.
function paintCompass(context, stage, directions) {
  const [left, bottom] = [44, stage.height - 44];
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = stage.color("ink");
  for (const [name, [dx, dy]] of Object.entries(directions)) {
    context.strokeStyle = stage.color("ink");
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(left, bottom);
    context.lineTo(left + 22 * dx, bottom - 22 * dy);
    context.stroke();
    label(context, stage, name, left + 31 * dx, bottom - 31 * dy);
  }
}

function paintScale(context, stage, unit) {
  const length = niceStep(120 / stage.scale);
  const [right, low] = [stage.width - 14, stage.height - 16];
  context.strokeStyle = context.fillStyle = stage.color("ink");
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(right, low);
  context.lineTo(right - length * stage.scale, low);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "right";
  context.textBaseline = "middle";
  label(context, stage, `${+length.toPrecision(1)}${unit}`, right, low - 11);
}

// A canvas that can be zoomed and dragged with mouse, fingers, buttons and keys. The owner has these methods:
// paint(context, stage); pick(x, y), which returns the item at a point in world coordinates, or -1; card(item), which
// returns the HTML elements that describe an item, or null; choose(item), which selects an item, or none for -1; where(x, y),
// which returns the coordinates of a point as text; and step(dx, dy), which selects the next item in a direction. If the owner has
// the method filter(), an area can be selected, to which filter() restricts the items.
class Stage {
  constructor(owner, box, { flip = false, label, keys, equal = true }) {
    Object.assign(this, { owner, box, flip: flip ? -1 : 1, equal, x: 0, y: 0, scale: 1, width: 1, height: 1 });
    this.canvas = make("canvas", { tabindex: 0, role: "application", "aria-label": label, "aria-roledescription": "plot" });
    this.help = make("p", { class: "keys" }, keys);
    this.tip = make("div", { class: "card", hidden: true, "aria-hidden": "true" });
    const button = (text, name, action) => make("button", { type: "button", "aria-label": name, title: name, onclick: action }, text);
    this.buttons = make("div", { class: "zoom", role: "group", "aria-label": "Zoom" },
      button("+", "Zoom in", () => this.zoom(1.6)),
      button("\u2212", "Zoom out", () => this.zoom(1 / 1.6)),
      button("\u2922", "Show everything", () => this.fit()));
    this.outline = make("div", { class: "area", hidden: true });
    this.areaButton = button("\u2b1a", "Select an area: drag a rectangle", () => this.selectArea(!this.selecting));
    if (owner.filter) this.buttons.append(this.areaButton);
    this.place = make("div", { class: "place", "aria-hidden": "true" });
    this.frame = make("div", { class: "stage" }, this.canvas, this.outline, this.buttons, this.place, this.tip);
    this.pointers = new Map();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.frame);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  resize() {
    const { clientWidth, clientHeight } = this.frame;
    if (!clientWidth) return;
    const ratio = devicePixelRatio || 1;
    const first = this.width === 1;
    [this.width, this.height] = [clientWidth, clientHeight];
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    if (first || this.whole) this.fit();
    this.paint();
  }

  fit(box = this.box) {
    const [x0, y0, x1, y1] = box;
    this.scale = Math.min(this.width / (x1 - x0 || 1), this.height / (y1 - y0 || 1)) * 0.94;
    [this.x, this.y] = [(x0 + x1) / 2, (y0 + y1) / 2];
    if (box === this.box) this.least = this.scale * 0.7;
    this.changed(box === this.box);
  }

  changed(whole = false) {
    this.whole = whole;
    this.canvas.style.touchAction = whole ? "pan-y" : "none"; // touches scroll the page while the plot is not enlarged
    this.tip.hidden = true;
    this.draw();
  }

  toScreen(x, y) {
    return [this.width / 2 + this.flip * (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toWorld(px, py) {
    return [this.x + this.flip * (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  // Zoom by a factor; the point (px, py) of the canvas does not move.
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, this.least), this.least * 2000);
    this.x = x - this.flip * (px - this.width / 2) / this.scale;
    this.y = y + (py - this.height / 2) / this.scale;
    this.changed();
  }

  pan(dx, dy) {
    const [x0, y0, x1, y1] = this.box;
    this.x = Math.min(Math.max(this.x - this.flip * dx / this.scale, x0), x1);
    this.y = Math.min(Math.max(this.y + dy / this.scale, y0), y1);
    this.changed();
  }

  show(x, y, scale) {
    Object.assign(this, { x, y, scale: Math.max(this.scale, scale) });
    this.changed();
  }

  // While an area is selected, the pointer draws its outline instead of moving the plot.
  selectArea(on) {
    this.selecting = on;
    this.areaButton.setAttribute("aria-pressed", on);
    this.canvas.style.touchAction = this.whole && !on ? "pan-y" : "none";
  }

  // Restrict the items to those between two corners x0, y0, x1, y1, or to no area.
  setArea(area) {
    this.area = area;
    this.showArea();
    this.owner.filter();
  }

  showArea() {
    this.outline.hidden = !this.area;
    if (!this.area) return;
    const [[ax, ay], [bx, by]] = [this.toScreen(...this.area.slice(0, 2)), this.toScreen(...this.area.slice(2))];
    const sides = [Math.min(ay, by), this.width - Math.max(ax, bx), this.height - Math.max(ay, by), Math.min(ax, bx)];
    this.outline.style.inset = sides.map((v) => `${v}px`).join(" ");
  }

  inArea(x, y) {
    const [x0, y0, x1, y1] = this.area ?? [];
    return !this.area || ((x - x0) * (x - x1) <= 0 && (y - y0) * (y - y1) <= 0);
  }

  draw() {
    this.pending ??= requestAnimationFrame(() => this.paint());
  }

  paint() {
    cancelAnimationFrame(this.pending);
    this.pending = undefined;
    const begin = performance.now();
    const ratio = this.canvas.width / this.width;
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    this.owner.paint(context, this);
    this.base = null;
    this.paintHovered();
    this.showArea();
    this.canvas.dataset.milliseconds = performance.now() - begin;
  }

  // The mark of the hovered item, above a copy of the plot, so that the pointer does not draw the plot again.
  paintHovered() {
    const { canvas, hovered = -1 } = this;
    if (!this.base && hovered < 0) return;
    const context = canvas.getContext("2d");
    if (!this.base) {
      this.base = new OffscreenCanvas(canvas.width, canvas.height);
      this.base.getContext("2d").drawImage(canvas, 0, 0);
    } else {
      context.clearRect(0, 0, this.width, this.height);
      context.drawImage(this.base, 0, 0, this.width, this.height);
    }
    if (hovered >= 0) this.owner.paintHovered(context, this, hovered);
  }

  color(name) {
    return getComputedStyle(this.frame).getPropertyValue(`--${name}`).trim();
  }

  hover(px, py) {
    const item = this.owner.pick(...this.toWorld(px, py));
    const content = item < 0 ? null : this.owner.card(item);
    this.tip.hidden = content === null;
    const changed = this.hovered !== item;
    this.hovered = item;
    if (changed && this.pending === undefined) this.paintHovered();
    if (content === null) return;
    this.tip.replaceChildren(...content);
    const { offsetWidth: w, offsetHeight: h } = this.tip;
    this.tip.style.left = `${Math.max(4, px + 16 + w > this.width ? px - 16 - w : px + 16)}px`;
    this.tip.style.top = `${Math.max(4, py + 16 + h > this.height ? py - 16 - h : py + 16)}px`;
  }

  listen() {
    const { canvas, pointers } = this;
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      this.zoom(Math.exp(-Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 120) / 400), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      if (pointers.size === 1) this.moved = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const [px, py] = [event.offsetX, event.offsetY];
      this.place.textContent = this.owner.where(...this.toWorld(px, py));
      const before = pointers.get(event.pointerId);
      if (!before) return this.hover(px, py);
      if (this.selecting) {
        this.area = [...(this.moved ? this.area.slice(0, 2) : this.toWorld(...before)), ...this.toWorld(px, py)];
        this.moved = Infinity;
        return this.showArea();
      }
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      pointers.set(event.pointerId, [px, py]);
      this.moved += Math.hypot(px - before[0], py - before[1]);
      if (other) {
        const ratio = Math.hypot(px - other[0], py - other[1]) / Math.hypot(before[0] - other[0], before[1] - other[1]);
        this.zoom(ratio || 1, (px + other[0]) / 2, (py + other[1]) / 2);
      } else if (this.moved > 4) this.pan(px - before[0], py - before[1]);
    });
    const end = (event) => { // of a click, or of an area
      const last = pointers.size === 1 && pointers.has(event.pointerId);
      pointers.delete(event.pointerId);
      if (last && this.selecting && this.moved) {
        this.selectArea(false);
        return this.setArea(this.area);
      }
      if (last && this.moved <= 4 && event.type === "pointerup") {
        const item = this.owner.pick(...this.toWorld(event.offsetX, event.offsetY));
        this.owner.choose(item);
      }
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => {
      this.tip.hidden = true;
      this.place.textContent = "";
    });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const actions = { "+": () => this.zoom(1.6), "=": () => this.zoom(1.6), "-": () => this.zoom(1 / 1.6), 0: () => this.fit(),
      Escape: () => { if (this.area) this.setArea(null); this.owner.choose(-1); },
      a: () => this.owner.filter && this.setArea([...this.toWorld(0, 0), ...this.toWorld(this.width, this.height)]), Enter: () => this.owner.enter?.() };
    const arrow = arrows[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !(arrow || actions[event.key])) return;
    event.preventDefault();
    if (!arrow) actions[event.key]();
    else if (event.shiftKey) this.pan(-60 * arrow[0], 60 * arrow[1]);
    else this.owner.step(this.flip * arrow[0], arrow[1]);
  }

  // The next item in a direction or, if none is selected, the item closest to the center of the plot; -1 if there is none.
  step(xs, ys, from, dx, dy, allowed = () => true) {
    const k = from < 0 ? nearest(xs, ys, this.x, this.y, Infinity, allowed) : this.next(xs, ys, from, dx, dy, allowed);
    if (k < 0) return;
    this.owner.choose(k);
    const [px, py] = this.toScreen(xs[k], ys[k]);
    if (px < 20 || py < 20 || px > this.width - 20 || py > this.height - 20) this.show(xs[k], ys[k], 0);
  }

  // The next item in a direction, for which the distance along the direction is small, and the distance across is small compared
  // with it. Repeated steps follow a straight line and visit each row of a lattice, even if the lattice has holes.
  next(xs, ys, from, dx, dy, allowed) {
    const [x, y] = [xs[from], ys[from]];
    if (this.last?.item !== from || (dx === 0) !== this.last.upward) this.last = { upward: dx === 0, x, y };
    const [x0, y0] = dx === 0 ? [this.last.x, y] : [x, this.last.y];
    let best = -1, least = Infinity;
    for (let k = 0; k < xs.length; k += 1) {
      const along = (xs[k] - x) * dx + (ys[k] - y) * dy;
      const across = Math.hypot(xs[k] - x0, ys[k] - y0) ** 2 - along ** 2;
      const size = along + 0.75 * Math.max(across, 0) / along;
      if (k !== from && along > 1e-9 && across <= 4 * along ** 2 && size < least && allowed(k)) [best, least] = [k, size];
    }
    this.last.item = best;
    return best;
  }
}

// Buttons that save the shown rows and the plot, and that write the selection into the address of the page, which restores it.
function addExports(view, live) {
  const names = view.id ?? view.name;
  const controls = [...live.querySelectorAll(".tools :is(select, input:not([type=search]))")].map((control) => control.getAttribute("aria-label"));
  const find = (label) => live.querySelector(`.tools [aria-label="${label}"]`);
  const button = (text, title, onclick) => make("button", { type: "button", title, "aria-label": title, onclick }, text);
  const link = () => {
    const entries = controls.map((label) => [label, find(label).type === "checkbox" ? find(label).checked : find(label).value]);
    if (view.selected >= 0) entries.push(["selected", names?.[view.selected] ?? view.selected]);
    if (view.stage?.area) entries.push(["area", view.stage.area.map((v) => +v.toPrecision(6)).join(" ")]);
    location.hash = new URLSearchParams(entries);
  };
  live.querySelector(".panes > div").append(make("div", { class: "export", role: "group", "aria-label": "Export" },
    view.fillTable ? button("CSV", "Save the shown rows as a CSV file", () => { if (!view.table) view.fillTable(); save(new Blob([view.table.csv()], { type: "text/csv" }), "csv"); }) : null,
    view.stage ? button("PNG", "Save the plot as a PNG file", () => picture(view)) : null,
    button("Link", "Write the selection into the address of the page", link)));
  const given = new URLSearchParams(location.hash.slice(1));
  const selected = names ? names.indexOf(given.get("selected")) : view.rows.indexOf(+(given.get("selected") ?? NaN));
  if (selected >= 0) view.choose(selected);
  for (const label of controls.filter((name) => given.has(name))) {
    const control = find(label), value = given.get(label);
    if (control.type === "checkbox") control.checked = value === "true";
    else if (!control.options || [...control.options].some((option) => option.value === value)) control.value = value;
    for (const name of ["input", "change"]) control.dispatchEvent(new Event(name));
  }
  const area = (given.get("area") ?? "").split(" ").map(Number);
  if (area.length === 4 && area.every(Number.isFinite) && view.stage) view.stage.setArea(area);
}

function save(blob, ending) {
  const address = URL.createObjectURL(blob);
  make("a", { href: address, download: `${document.title.replace(/[^\w.+-]+/g, "_")}.${ending}` }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
}

// Save the plot with its background, and its legend below.
function picture({ stage, legend }) {
  const ratio = stage.canvas.width / stage.width, lines = [...legend.children];
  const copy = make("canvas", { width: stage.canvas.width, height: stage.canvas.height + Math.ceil((20 * lines.length + 12) * ratio) });
  const context = copy.getContext("2d");
  context.fillStyle = stage.color("c-field");
  context.fillRect(0, 0, copy.width, copy.height);
  context.drawImage(stage.canvas, 0, 0);
  context.scale(ratio, ratio);
  context.font = "12px system-ui, sans-serif";
  lines.forEach((line, k) => {
    const mark = line.querySelector(".mark"), y = stage.height + 20 * k + 18;
    context.fillStyle = context.strokeStyle = getComputedStyle(mark).getPropertyValue("--color").trim() || "transparent";
    const symbol = mark.matches(".diamond") ? "\u25c6" : mark.matches(".ring, .open") ? "\u25cb" : mark.matches(".dashed") ? "\u254c" : mark.matches(".line") ? "\u2500" : "\u25cf";
    context.fillText(symbol, 9, y);
    context.fillStyle = stage.color("ink");
    context.fillText(line.textContent, mark.matches(".none") ? 8 : 30, y);
  });
  copy.toBlob((blob) => save(blob, "png"));
}

const VIEWS = {};

// All views of the page are started after the scripts of all kinds have been read; compressed data are expanded first.
function startViews() {
  for (const section of document.querySelectorAll(".view")) {
    const start = (data) => {
      const live = make("div", { class: "live", role: "region", "aria-label": section.dataset.caption });
      section.prepend(live);
      section.classList.add("started");
      section.view = new VIEWS[section.dataset.view](live, data);
      if (section.view.choose && !document.body.classList.contains("framed")) addExports(section.view, live);
    };
    const data = JSON.parse(section.querySelector("script").textContent);
    if (data.deflated) expand(data.deflated).then(start);
    else start(data);
  }
}

async function expand(text) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
}
addEventListener("DOMContentLoaded", startViews);
