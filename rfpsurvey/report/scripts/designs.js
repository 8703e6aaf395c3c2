// Designs as points: two plots with the same horizontal axis, whose zoom and selection are linked.

class Scatter {
  constructor(owner, y) {
    Object.assign(this, { owner, y });
    this.stage = new Stage(this, [0, 0, 1.6, 1], { label: "", keys: "" });
    this.stage.frame.classList.add("plot");
    const changed = this.stage.changed.bind(this.stage);
    this.stage.changed = (whole) => { changed(whole); owner.follow(this); };
  }

  // World coordinates of a design: x from 0 to 1.6 and y from 0 to 1, which span the ranges of the two plotted columns.
  place(k) {
    const scaled = (name) => (this.owner.columns[name][k] - this.owner.ranges[name][0]) / this.owner.ranges[name][1];
    return [1.6 * scaled(this.owner.x), scaled(this.y)];
  }

  update() {
    this.points = this.owner.rows.map((k) => this.place(k));
    this.stage.canvas.setAttribute("aria-label", `${this.owner.words(this.y)} as a function of ${this.owner.words(this.owner.x)} for ` +
      `${plural(this.owner.rows.length, "design")}. Arrow keys select designs.`);
    this.stage.draw();
  }

  paint(context, stage) {
    const { owner } = this;
    context.font = "12px system-ui, sans-serif";
    const labels = this.paintAxes(context, stage);
    const objectives = Object.keys(owner.data.objectives);
    if (objectives.includes(owner.x) && objectives.includes(this.y)) {
      const front = owner.rows.filter((k) => owner.pareto[k] === 1).sort((a, b) => owner.columns[owner.x][a] - owner.columns[owner.x][b]);
      context.strokeStyle = stage.color("c-collision");
      context.lineWidth = 1.5;
      context.beginPath();
      front.forEach((k, i) => (i ? context.lineTo(...stage.toScreen(...this.points[k])) : context.moveTo(...stage.toScreen(...this.points[k]))));
      context.stroke();
    }
    for (const [name, test] of [["c-arm", (k) => !owner.pareto[k]], ["c-collision", (k) => owner.pareto[k]], ["c-star", (k) => owner.instrument[k] !== ""]]) {
      context.fillStyle = stage.color(name);
      context.beginPath();
      for (const k of owner.rows) {
        if (!test(k) || !Number.isFinite(this.points[k][0] + this.points[k][1])) continue;
        const [px, py] = stage.toScreen(...this.points[k]);
        const size = owner.instrument[k] ? 8 : owner.pareto[k] ? 5 : 3.5;
        context.moveTo(px + size, py);
        if (owner.instrument[k]) context.rect(px - size, py - size, 2 * size, 2 * size);
        else context.arc(px, py, size, 0, 2 * Math.PI);
      }
      context.fill();
    }
    for (const k of owner.rows) {
      if (!owner.instrument[k]) continue;
      const [px, py] = stage.toScreen(...this.points[k]);
      const right = px > stage.width - 120; // beside the edge, the name is on the left
      labels.push([owner.instrument[k], right ? px - 12 : px + 12, py, right ? "right" : "left"]);
    }
    context.fillStyle = stage.color("ink");
    context.textBaseline = "middle";
    for (const [text, px, py, align] of labels) {
      context.textAlign = align;
      label(context, stage, text, px, py);
    }
    if (owner.selected >= 0) this.paintRing(context, stage, owner.selected, 2.5);
  }

  paintRing(context, stage, k, width) {
    const [px, py] = stage.toScreen(...this.points[k]);
    context.strokeStyle = stage.color("c-mark");
    context.lineWidth = width;
    context.beginPath();
    context.arc(px, py, 9, 0, 2 * Math.PI);
    context.stroke();
  }

  paintHovered(context, stage, k) { this.paintRing(context, stage, k, 1); }

  paintAxes(context, stage) {
    const { owner } = this;
    const [x0, y0] = stage.toWorld(0, stage.height), [x1, y1] = stage.toWorld(stage.width, 0);
    context.strokeStyle = stage.color("faint");
    context.fillStyle = stage.color("soft");
    context.lineWidth = 1;
    context.beginPath();
    const labels = [];
    for (const [name, low, high, across] of [[owner.x, x0 / 1.6, x1 / 1.6, true], [this.y, y0, y1, false]]) {
      const [zero, range] = owner.ranges[name];
      const step = niceStep((high - low) * range / 3);
      for (let k = Math.ceil((zero + low * range) / step); k * step <= zero + high * range; k += 1) {
        const part = (k * step - zero) / range;
        const [px, py] = stage.toScreen(1.6 * part, part);
        context.moveTo(across ? px : 0, across ? 0 : py);
        context.lineTo(across ? px : stage.width, across ? stage.height : py);
        const text = String(+(k * step).toPrecision(6));
        if (across) labels.push([text, Math.min(px, stage.width - 14), stage.height - 8, "center"]);
        else if (py < stage.height - 24 && py > 34) labels.push([text, 4, py - 8, "left"]);
      }
    }
    context.stroke();
    return labels.concat([[owner.words(owner.x), stage.width - 8, stage.height - 26, "right"], [owner.words(this.y), 8, 14, "left"]]);
  }

  pick(x, y) {
    return nearest(this.points.map(([px]) => px), this.points.map(([, py]) => py), x, y, 12 / this.stage.scale);
  }

  card(k) { return this.owner.card(k); }

  where(x, y) {
    const { owner } = this;
    const value = (name, part) => `${name.replaceAll("_", " ")} ${+(owner.ranges[name][0] + part * owner.ranges[name][1]).toPrecision(4)}`;
    return `${value(owner.x, x / 1.6)}, ${value(this.y, y)}`;
  }

  choose(k) { this.owner.choose(k); }

  step(dx, dy) {
    this.stage.step(this.points.map(([x]) => x), this.points.map(([, y]) => y), this.owner.selected, dx, dy);
  }
}

class DesignsView {
  constructor(live, data) {
    Object.assign(this, { data, selected: -1 });
    this.columns = Object.fromEntries(Object.entries(data.columns).map(([name, column]) => [name, unpack(column, data.n)]));
    this.pareto = unpack(data.pareto, data.n);
    this.instrument = unpack(data.instrument, data.n);
    this.rows = Array.from({ length: data.n }, (_, k) => k);
    this.ranges = Object.fromEntries(Object.entries(this.columns).map(([name, values]) => {
      const [low, high] = extent(values.filter(Number.isFinite));
      return [name, [low, high - low || 1]];
    }));
    const [first, second] = Object.keys(data.objectives);
    this.x = first;
    const parameters = ["pitch", "ratio", "central_arm", "clearance"].filter((name) => new Set(this.columns[name]).size > 1);
    this.plots = [new Scatter(this, second), new Scatter(this, parameters[0] ?? "pitch")];
    const names = Object.keys(this.columns).map((name) => [name, name.replaceAll("_", " ")]);
    const tools = make("div", { class: "tools" });
    for (const [words, value, set] of [["Horizontal", this.x, (name) => { this.x = name; }], ["Upper plot", this.plots[0].y, (name) => { this.plots[0].y = name; }],
      ["Lower plot", this.plots[1].y, (name) => { this.plots[1].y = name; }]]) {
      const [field, box] = select(words, [["", names]], (event) => { set(event.target.value); this.update(); });
      box.value = value;
      tools.append(field);
    }
    this.panel = make("div", { class: "panel", "aria-live": "polite" });
    const keys = make("p", { class: "keys" }, "Ctrl with the wheel, two fingers, + and \u2212: zoom; both plots show the same range of the horizontal axis. Drag, or Shift with arrow keys: " +
      "move. 0: show everything. Arrow keys: select a design. Large points are on the Pareto front: no other design is better in both objectives. Squares are instruments.");
    this.about = make("dl", { class: "about" });
    live.append(tools, make("div", { class: "panes" }, make("div", { class: "linked" }, ...this.plots.map((plot) => plot.stage.frame), this.about, keys), this.panel));
    this.update();
    this.choose(-1);
  }

  words(name) {
    const unit = this.data.units[name];
    return name.replaceAll("_", " ") + (unit ? ` [${unit}]` : "");
  }

  update() {
    for (const plot of this.plots) plot.update();
    const shown = [...new Set([this.x, ...this.plots.map((plot) => plot.y)])];
    this.about.replaceChildren(...shown.flatMap((name) => [make("dt", {}, this.words(name)), make("dd", {}, this.data.meanings[name] ?? "")]));
  }

  // The other plot shows the same part of the horizontal axis.
  follow(plot) {
    for (const other of this.plots ?? []) {
      if (other === plot) continue;
      Object.assign(other.stage, { x: plot.stage.x, scale: plot.stage.scale, whole: plot.stage.whole });
      other.stage.canvas.style.touchAction = plot.stage.canvas.style.touchAction;
      other.stage.draw();
    }
  }

  card(k, long = false) {
    const show = (value) => (Number.isInteger(value) ? String(value) : Number.isFinite(value) ? String(+value.toPrecision(5)) : "\u2013");
    const shown = [...new Set([...Object.keys(this.data.objectives), ...Object.keys(this.columns)])].slice(0, long ? undefined : 8);
    return [make(long ? "h3" : "p", {}, make("strong", {}, this.instrument[k] || `Design ${k}`)),
      ...(this.pareto[k] ? [make("p", {}, "This design is on the Pareto front.")] : []), list(shown.map((name) => [this.words(name), show(this.columns[name][k])]))];
  }

  choose(k) {
    this.selected = k;
    this.panel.replaceChildren(...(k < 0 ? [make("p", {}, "Click a design to see its values, and to copy it to the calculator.")] : this.card(k, true)));
    for (const plot of this.plots) plot.stage.draw();
    if (k < 0) return;
    const { central_arm: arm, ratio, pitch, clearance } = this.columns;
    const detail = { central_arm: arm[k], eccentric_arm: arm[k] * ratio[k], pitch: pitch[k], clearance: clearance[k] };
    document.dispatchEvent(new CustomEvent("design", { detail }));
  }
}
VIEWS.designs = DesignsView;
