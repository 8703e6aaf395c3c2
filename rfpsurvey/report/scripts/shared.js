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

// A canvas that can be zoomed and dragged with mouse, fingers, buttons and keys. The owner has these methods:
// paint(context, stage); pick(x, y), which returns the item at a point in world coordinates, or -1; card(item), which
// returns the HTML elements that describe an item, or null; choose(item), which selects an item, or none for -1; and
// step(dx, dy), which selects the next item in a direction.
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
    this.frame = make("div", { class: "stage" }, this.canvas, this.buttons, this.tip);
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
    this.canvas.dataset.milliseconds = performance.now() - begin;
  }

  color(name) {
    return getComputedStyle(this.frame).getPropertyValue(`--${name}`).trim();
  }

  hover(px, py) {
    const item = this.owner.pick(...this.toWorld(px, py));
    const content = item < 0 ? null : this.owner.card(item);
    this.tip.hidden = content === null;
    if (this.hovered !== item) this.draw();
    this.hovered = item;
    if (content === null) return;
    this.tip.replaceChildren(...content);
    const { offsetWidth: w, offsetHeight: h } = this.tip;
    this.tip.style.left = `${Math.max(4, px + 16 + w > this.width ? px - 16 - w : px + 16)}px`;
    this.tip.style.top = `${Math.max(4, py + 16 + h > this.height ? py - 16 - h : py + 16)}px`;
  }

  listen() {
    const { canvas, pointers } = this;
    canvas.addEventListener("wheel", (event) => {
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
      const before = pointers.get(event.pointerId);
      if (!before) return this.hover(px, py);
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      pointers.set(event.pointerId, [px, py]);
      this.moved += Math.hypot(px - before[0], py - before[1]);
      if (other) {
        const ratio = Math.hypot(px - other[0], py - other[1]) / Math.hypot(before[0] - other[0], before[1] - other[1]);
        this.zoom(ratio || 1, (px + other[0]) / 2, (py + other[1]) / 2);
      } else if (this.moved > 4) this.pan(px - before[0], py - before[1]);
    });
    const end = (event) => {
      const last = pointers.size === 1 && pointers.has(event.pointerId);
      pointers.delete(event.pointerId);
      if (last && this.moved <= 4 && event.type === "pointerup") {
        const item = this.owner.pick(...this.toWorld(event.offsetX, event.offsetY));
        this.owner.choose(item);
      }
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const actions = { "+": () => this.zoom(1.6), "=": () => this.zoom(1.6), "-": () => this.zoom(1 / 1.6), 0: () => this.fit(),
      Escape: () => this.owner.choose(-1), Enter: () => this.owner.enter?.() };
    const arrow = arrows[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !(arrow || actions[event.key])) return;
    event.preventDefault();
    if (!arrow) actions[event.key]();
    else if (event.shiftKey) this.pan(-60 * arrow[0], 60 * arrow[1]);
    else this.owner.step(this.flip * arrow[0], arrow[1]);
  }
}

// The nearest item in a direction from another item; distances perpendicular to this direction count twice.
function nextItem(xs, ys, from, dx, dy, allowed) {
  let best = -1, least = Infinity;
  for (let k = 0; k < xs.length; k += 1) {
    const along = (xs[k] - xs[from]) * dx + (ys[k] - ys[from]) * dy;
    const across = Math.abs((xs[k] - xs[from]) * dy) + Math.abs((ys[k] - ys[from]) * dx);
    const distance = along + 2 * across;
    if (k !== from && along > 1e-9 && across <= 2 * along && distance < least && allowed(k)) [best, least] = [k, distance];
  }
  return best;
}

const VIEWS = {};

// All views of the page are started after the scripts of all kinds have been read.
function startViews() {
  for (const section of document.querySelectorAll(".view")) {
    const data = JSON.parse(section.querySelector("script").textContent);
    const live = make("div", { class: "live", role: "region", "aria-label": section.dataset.caption });
    section.prepend(live);
    section.classList.add("started");
    section.view = new VIEWS[section.dataset.view](live, data);
  }
}
addEventListener("DOMContentLoaded", startViews);
