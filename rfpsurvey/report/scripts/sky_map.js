// Tiles on the sky, colored by a column, with a slider that selects the passes.

const RAMPS = { light: [[198, 226, 244], [0, 114, 178], [30, 16, 70]], dark: [[52, 74, 92], [86, 180, 233], [255, 236, 160]] };
const BINS = 8;
const RAD = Math.PI / 180;

// Equal-area projections, in degrees: Hammer's for the whole sky, Lambert's around a center. x increases to the east.
function projection(whole, ra0, dec0) {
  const [sin0, cos0] = [Math.sin(dec0 * RAD), Math.cos(dec0 * RAD)];
  return (ra, dec) => {
    const east = (((ra - ra0) % 360 + 540) % 360 - 180) * RAD * (whole ? 0.5 : 1);
    const [sin, cos] = [Math.sin(dec * RAD), Math.cos(dec * RAD)];
    const near = whole ? cos * Math.cos(east) : sin0 * sin + cos0 * cos * Math.cos(east);
    const k = Math.sqrt(2 / Math.max(1 + near, 1e-12)) / RAD;
    return whole ? [2 * k * cos * Math.sin(east), k * sin] : [k * cos * Math.sin(east), k * (cos0 * sin - sin0 * cos * Math.cos(east))];
  };
}

class SkyMapView {
  constructor(live, data) {
    const n = data.n;
    Object.assign(this, { live, data, n, selected: -1, upTo: Infinity, from: -Infinity });
    this.columns = Object.fromEntries(Object.entries(data.columns).map(([name, column]) => [name, unpack(column, n)]));
    this.ra = unpack(data.ra, n);
    this.dec = unpack(data.dec, n);
    this.name = this.columns.tile.map(String);
    this.project = projection(data.whole, ...data.center);
    const places = this.ra.map((ra, k) => this.project(ra, this.dec[k]));
    this.x = places.map(([x]) => x);
    this.y = places.map(([, y]) => y);
    this.passes = [...new Set(this.columns.pass)].sort((a, b) => a - b);
    this.grid = this.graticule();
    const range = (values) => values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const [[x0, x1], [y0, y1]] = [range(this.x), range(this.y)];
    const r = data.radius;
    const box = data.whole ? [-163, -82, 163, 82] : [x0 - r, y0 - r, x1 + r, y1 + r];
    this.stage = new Stage(this, box, { flip: true, label: `Map of ${plural(n, "tile")}, east to the left. Arrow keys select tiles.`,
      keys: "Wheel, two fingers, + and \u2212: zoom. Drag, or Shift with arrow keys: move. 0: show everything. Arrow keys: select a tile. " +
        "Escape: end the selection." });
    if (data.whole) this.stage.frame.classList.add("low");
    this.panel = make("div", { class: "panel", "aria-live": "polite" });
    this.count = make("p", { class: "count", role: "status" });
    this.legend = make("ul", { class: "legend" });
    live.append(this.tools(), make("div", { class: "panes" }, make("div", {}, this.stage.frame, this.legend, this.count, this.stage.help), this.panel));
    this.colorBy(this.column);
    this.choose(-1);
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
    const search = make("input", { type: "search", placeholder: "tile", autocomplete: "off", "aria-label": "Search for a tile" });
    box.append(make("form", { class: "field", role: "search", onsubmit: (event) => { event.preventDefault(); this.find(search.value.trim()); } },
      make("label", {}, make("span", {}, "Tile "), search)));
    return box;
  }

  setPass(pass, only) {
    [this.from, this.upTo] = [only ? pass : -Infinity, pass];
    this.slider.setAttribute("aria-valuetext", `pass ${pass}`);
    this.update();
  }

  colorBy(column) {
    this.column = column;
    const values = this.columns[column].filter(Number.isFinite);
    const [low, high] = values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const whole = values.every(Number.isInteger) && high - low < BINS;
    this.edges = whole ? Array.from({ length: high - low + 1 }, (_, k) => low + k) :
      Array.from({ length: high > low ? BINS : 1 }, (_, k) => low + (high - low) * k / BINS);
    const size = whole ? 1 : (high - low) / BINS || 1;
    this.bin = this.columns[column].map((v) => (Number.isFinite(v) ? Math.min(Math.floor((v - low) / size), this.edges.length - 1) : -1));
    this.words = this.edges.map((edge) => (whole ? String(edge) : `${+edge.toPrecision(3)} to ${+(edge + size).toPrecision(3)}`));
    this.update();
  }

  shown(k) {
    return this.columns.pass[k] <= this.upTo && this.columns.pass[k] >= this.from;
  }

  update() {
    const n = this.name.reduce((sum, _, k) => sum + (this.shown(k) ? 1 : 0), 0);
    this.count.textContent = `Shown: ${n} of ${plural(this.n, "tile")}.`;
    if (this.passText) {
      const last = this.passes[+this.slider.value];
      this.passText.textContent = this.only.checked || last === this.passes[0] ? `Pass ${last}` : `Passes ${this.passes[0]} to ${last}`;
    }
    this.legend.replaceChildren(...this.words.map((words, bin) => {
      const dot = make("span", { "aria-hidden": "true" });
      dot.style.background = this.binColor(bin);
      return make("li", {}, dot, words);
    }));
    this.stage.draw();
  }

  binColor(bin) {
    const ramp = RAMPS[matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"];
    const at = this.edges.length > 1 ? 2 * bin / (this.edges.length - 1) : 1;
    const k = Math.min(Math.floor(at), 1);
    return `rgb(${ramp[k].map((v, i) => Math.round(v + (ramp[k + 1][i] - v) * (at - k))).join(" ")})`;
  }

  graticule() {
    const step = this.data.whole ? 30 : 10;
    const lines = [];
    const add = (points) => lines.push(points.map(([ra, dec]) => this.project(ra, dec)));
    const along = (from, to, f) => Array.from({ length: 61 }, (_, k) => f(from + (to - from) * k / 60));
    const [ra0, dec0] = this.data.center;
    const near = this.data.whole ? 180 : 60;
    for (let d = -180; d <= 180; d += step) {
      const ra = this.data.whole ? ra0 + Math.min(Math.max(d, -179.999), 179.999) : Math.round(ra0 / step) * step + d;
      if (Math.abs(d) <= near) add(along(Math.max(-90, dec0 - near), Math.min(90, dec0 + near), (dec) => [ra, dec]));
    }
    for (let dec = -80 - (this.data.whole ? 10 : 0); dec <= 80 + (this.data.whole ? 10 : 0); dec += step) {
      if (this.data.whole || Math.abs(dec - dec0) < near) add(along(ra0 - near + 0.001, ra0 + near - 0.001, (ra) => [ra, dec]));
    }
    return lines;
  }

  // ---- drawing

  paint(context, stage) {
    context.strokeStyle = stage.color("faint");
    context.lineWidth = 1;
    context.beginPath();
    for (const line of this.grid) line.forEach(([x, y], k) => (k ? context.lineTo(...stage.toScreen(x, y)) : context.moveTo(...stage.toScreen(x, y))));
    context.stroke();
    const bins = this.edges.map(() => []);
    const r = this.data.radius * stage.scale;
    const margin = Math.min(r, 200);
    for (let k = 0; k < this.n; k += 1) {
      if (this.bin[k] < 0 || !this.shown(k)) continue;
      const [px, py] = stage.toScreen(this.x[k], this.y[k]);
      if (px > -margin && py > -margin && px < stage.width + margin && py < stage.height + margin) bins[this.bin[k]].push(k);
    }
    const large = r > 12;
    bins.forEach((rows, bin) => {
      context.fillStyle = context.strokeStyle = this.binColor(bin);
      context.beginPath();
      if (large) for (const k of rows) this.pathOf(context, stage, k);
      else {
        const size = Math.max(1, r * 0.45);
        for (const k of rows) {
          const [px, py] = stage.toScreen(this.x[k], this.y[k]);
          context.rect(px - size, py - size, 2 * size, 2 * size);
        }
      }
      if (!large) return context.fill();
      context.globalAlpha = 0.25;
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = 1.2;
      return context.stroke();
    });
    for (const [k, width] of [[stage.hovered ?? -1, 1.5], [this.selected, 3]]) {
      if (k < 0) continue;
      context.strokeStyle = stage.color("c-mark");
      context.lineWidth = width;
      context.beginPath();
      this.pathOf(context, stage, k);
      context.stroke();
    }
  }

  // The edge of a field, a circle on the sphere, as a polygon on the map.
  pathOf(context, stage, k) {
    this.rims ??= new Map();
    if (!this.rims.has(k)) {
      const [sin, cos] = [Math.sin(this.dec[k] * RAD), Math.cos(this.dec[k] * RAD)];
      const [sinR, cosR] = [Math.sin(this.data.radius * RAD), Math.cos(this.data.radius * RAD)];
      this.rims.set(k, Array.from({ length: 36 }, (_, i) => {
        const angle = i * Math.PI / 18;
        const up = Math.max(-1, Math.min(1, sin * cosR + cos * sinR * Math.cos(angle)));
        const east = Math.atan2(Math.sin(angle) * sinR * cos, cosR - sin * up);
        return this.project(this.ra[k] + east / RAD, Math.asin(up) / RAD);
      }));
    }
    const rim = this.rims.get(k);
    const step = this.data.radius * stage.scale > 40 ? 1 : 3;
    const far = 40 + 6 * this.data.radius * stage.scale; // a field at the edge of the map appears on both sides
    let [beforeX, beforeY] = [NaN, NaN];
    for (let i = 0; i <= rim.length; i += step) {
      const [x, y] = rim[i % rim.length];
      const [px, py] = stage.toScreen(x, y);
      if (Math.abs(px - beforeX) + Math.abs(py - beforeY) < far) context.lineTo(px, py);
      else context.moveTo(px, py);
      [beforeX, beforeY] = [px, py];
    }
  }

  // ---- selection

  pick(x, y) {
    let best = -1, least = Math.max(this.data.radius * 1.2, 8 / this.stage.scale);
    for (let k = 0; k < this.n; k += 1) {
      const distance = Math.hypot(this.x[k] - x, this.y[k] - y);
      if (distance < least && this.shown(k)) [best, least] = [k, distance];
    }
    return best;
  }

  card(k, long = false) {
    const show = (value) => (typeof value === "string" ? value : Number.isInteger(value) ? String(value) : fixed(value, 4));
    const columns = Object.entries(this.columns).filter(([name]) => name !== "tile");
    return [make(long ? "h3" : "p", {}, make("strong", {}, `Tile ${this.name[k]}`)),
      list([["ra", fixed(this.ra[k], 4, "\u00b0")], ["dec", fixed(this.dec[k], 4, "\u00b0")],
        ...columns.map(([name, values]) => [name.replaceAll("_", " "), show(values[k])])])];
  }

  choose(k) {
    this.selected = k;
    this.panel.replaceChildren(...(k < 0 ? [make("p", {}, "Click a tile, or search for its number, to see its values.")] : this.card(k, true)));
    this.stage.draw();
  }

  find(text) {
    const k = this.name.indexOf(text);
    if (k < 0) return this.panel.replaceChildren(make("p", {}, `No tile has the number ${text}.`));
    this.choose(k);
    return this.stage.show(this.x[k], this.y[k], 60 / this.data.radius);
  }

  step(dx, dy) {
    if (this.selected < 0) {
      const distances = this.x.map((x, k) => (this.shown(k) ? Math.hypot(x - this.stage.x, this.y[k] - this.stage.y) : Infinity));
      return this.choose(distances.indexOf(Math.min(...distances)));
    }
    const next = nextItem(this.x, this.y, this.selected, dx, dy, (k) => this.shown(k));
    return next < 0 ? undefined : this.choose(next);
  }
}
VIEWS.sky_map = SkyMapView;
