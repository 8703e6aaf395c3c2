// The focal plane of a tile: one plan, or the differences of two plans.

class FocalPlaneView extends FocalPlaneDrawing {
  constructor(live, data) {
    super();
    const n = data.n;
    Object.assign(this, { live, data, n, selected: -1 });
    for (const name of ["id", "x", "y", "inner", "outer"]) this[name] = unpack(data[name], n);
    this.plans = data.plans.map((plan) => this.read(plan));
    this.plan = this.plans[0];
    this.compared = this.plans[1] ?? null;
    this.row = new Map(this.id.map((name, k) => [name, k]));
    const reach = Math.max(...this.outer);
    const [[x0, x1], [y0, y1]] = [extent(this.x), extent(this.y)];
    this.stage = new Stage(this, [x0 - reach, y0 - reach, x1 + reach, y1 + reach], {
      flip: true, label: `Focal plane of ${data.instrument} with ${plural(n, "positioner")}. Arrow keys select positioners.`,
      keys: "Ctrl with the wheel, two fingers, + and \u2212: zoom. Drag, or Shift with arrow keys: move. 0: show everything. Arrow keys: select a neighbor. " +
        "A: restrict the table to the visible part. Enter: show the row in the table. Escape: end the selection." });
    this.panel = make("div", { class: "panel", "aria-live": "polite" });
    this.count = make("p", { class: "count", role: "status" });
    this.legend = make("ul", { class: "legend" });
    live.append(this.tools(), make("div", { class: "panes" }, make("div", {}, this.stage.frame, this.legend, this.count, this.stage.help), this.panel),
      this.tableBox());
    this.update();
    this.choose(-1);
  }

  read(plan) {
    const n = this.n;
    const own = { name: plan.name, idle: plan.idle, has: plan.columns };
    for (const [name, column] of Object.entries(plan.columns)) own[name] = unpack(column, n);
    own.elbow_x = own.elbow_dx.map((v, k) => v + this.x[k]);
    own.elbow_y = own.elbow_dy.map((v, k) => v + this.y[k]);
    const kind = own.kind ?? Array(n).fill("science");
    own.state = own.status.map((status, k) => {
      if (own.colliding_with[k]) return ["disabled", "stuck", "recorded"].includes(status) ? "struck" : "collision";
      if (status === "assigned") return (kind[k] || "science").split("+")[0];
      return status === "out_of_reach" ? "reach" : status === "disabled" || status === "stuck" ? "unusable" : "idle";
    });
    own.reason = Array(n).fill(null);
    for (const [k, ...entry] of plan.idle ?? []) own.reason[k] = entry;
    own.free = new Map();
    for (const [k, ...target] of plan.free) own.free.set(k, [...(own.free.get(k) ?? []), target]);
    return own;
  }

  // ---- controls

  tools() {
    const named = this.plans.map((plan, k) => [k, plan.name]);
    const box = make("div", { class: "tools" });
    if (this.plans.length > 1) {
      const [first] = select("Plan", [["", named]], (event) => this.set(+event.target.value, this.plans.indexOf(this.compared)));
      const [second, value] = select("Compared with", [["", [[-1, "no other plan"], ...named]]],
        (event) => this.set(this.plans.indexOf(this.plan), +event.target.value));
      value.value = 1;
      box.append(first, second);
    }
    this.filterField = make("span");
    const search = make("input", { type: "search", placeholder: this.data.sky ? "id, or ra dec" : "id", spellcheck: "false", autocomplete: "off" });
    const find = make("form", { class: "field", role: "search", onsubmit: (event) => { event.preventDefault(); this.find(search.value.trim()); } },
      make("label", {}, make("span", {}, "Positioner or target "), search));
    search.setAttribute("aria-label", "Search for a positioner or a target by its id");
    search.addEventListener("search", () => this.find(search.value.trim()));
    box.append(this.filterField, find);
    return box;
  }

  set(first, second) {
    this.plan = this.plans[first];
    this.compared = this.plans[second] === this.plan ? null : this.plans[second] ?? null;
    this.update();
    this.choose(this.selected, false);
  }

  // All filters by group, as [value, text, test]; `update` omits filters that select no positioner.
  filters() {
    const { plan, compared } = this;
    const groups = new Map([["", [["all", "all positioners", () => true]]]]);
    const add = (group, value, text, test) => groups.set(group, [...(groups.get(group) ?? []), [value, text, test]]);
    for (const [state, [name]] of Object.entries(STATES)) add("State", state, name, (k) => plan.state[k] === state);
    add("State", "assigned", "any target", (k) => plan.target_id[k] !== "");
    if (plan.idle) this.data.reasons.forEach((reason, code) => add("Why idle", `reason ${code}`, reason, (k) => plan.reason[k]?.[0] === code));
    if (compared) {
      add("State", "other collision", `in collision in the plan ${compared.name}`, (k) => compared.colliding_with[k] !== "");
      add("Differences", "changed", "any difference", (k) => this.change(k) !== "same");
      for (const kind of Object.keys(CHANGES)) add("Differences", kind, this.changeName(kind), (k) => this.change(k) === kind);
    }
    for (const column of ["category", "priority", "fiber_type", "spectrograph"]) {
      const values = plan[column] && [...new Set(plan[column].filter((v, k) => plan.target_id[k] && !Number.isNaN(v)))];
      if (!values || values.length < 2 || values.length > 20) continue;
      for (const value of values.sort((a, b) => (typeof a === "number" ? a - b : words.compare(a, b)))) add(column.replace("_", " "), `${column} ${value}`, String(value), (k) => plan.target_id[k] && plan[column][k] === value);
    }
    return groups;
  }

  update() {
    const before = this.filterBox?.value ?? "all";
    this.tests = new Map();
    const groups = [];
    for (const [group, entries] of this.filters()) {
      const shown = [];
      for (const [value, text, test] of entries) {
        const n = this.id.reduce((sum, _, k) => sum + (test(k) ? 1 : 0), 0);
        if (!n && value !== "all") continue;
        this.tests.set(value, test);
        shown.push([value, `${text} (${n})`]);
      }
      if (shown.length) groups.push([group, shown]);
    }
    const [field, box] = select("Show", groups, () => this.filter());
    this.filterField.replaceChildren(field);
    this.filterBox = box;
    box.value = this.tests.has(before) ? before : "all";
    this.filter();
  }

  filter() {
    const test = this.tests.get(this.filterBox.value);
    this.visible = this.id.map((_, k) => Boolean(test(k)) && this.stage.inArea(this.x[k], this.y[k]));
    const n = this.visible.filter(Boolean).length;
    this.count.textContent = `Shown: ${n} of ${plural(this.n, "positioner")}${this.compared ? `; ${this.plan.name} compared with ${this.compared.name}` : ""}.`;
    this.fillLegend();
    if (this.details.open) this.fillTable();
    else this.table = null;
    this.stage.draw();
  }

  fillLegend() {
    const { plan, compared } = this;
    const entries = compared ? Object.entries(CHANGES).map(([kind, [, color]]) => [this.changeName(kind), color, "dot"]) :
      Object.entries(STATES).filter(([state]) => plan.state.includes(state)).map(([, [name, color, shape]]) => [name, color, shape ?? "dot"]);
    if (this.data.obstacles.length + this.data.polygons.length) entries.push(["fiducial or other obstacle", "c-obstacle", "pale dot"]);
    if (compared) {
      entries.push(["no target", "ink", "ring"], [`arm in the plan ${plan.name} (enlarged plot)`, "ink", "line"], [`arm in the plan ${compared.name}, if different`, "ink", "dashed"],
        [`in collision in the plan ${plan.name}`, "c-collision", "diamond"], [`in collision in the plan ${compared.name}`, "c-collision", "open diamond"]);
    }
    fillLegend(this.legend, entries.map(([name, color, shape]) => [name, `var(--${color})`, shape]));
  }

  // All rows to which an id belongs, with a sentence for each: a positioner and a target can have the same id.
  matches(text) {
    const found = this.row.has(text) ? [[this.row.get(text), `${text} is the id of a positioner.`]] : [];
    const named = this.compared ? (plan) => ` in the plan ${plan.name}` : () => "";
    for (const plan of this.compared ? [this.plan, this.compared] : [this.plan]) {
      const k = plan.target_id.indexOf(text);
      const free = k >= 0 ? [] : [...plan.free].filter(([, targets]) => targets.some(([name]) => name === text)).map(([own]) => own);
      if (k >= 0) found.push([k, `${text} is the id of a target, to which the positioner ${this.id[k]} is assigned${named(plan)}.`]);
      if (free.length) {
        found.push([free[0], `${text} is the id of a target without a positioner${named(plan)}, in reach of ` +
          `${plural(free.length, "idle positioner")}: ${free.map((own) => this.id[own]).join(", ")}.`]);
      }
    }
    return found;
  }

  find(text) {
    if (!text) return;
    const found = this.matches(text);
    const place = coordinates(text);
    if (!found.length && place && this.data.sky) this.findPlace(...this.fromSky(...place));
    else if (!found.length) {
      this.panel.replaceChildren(make("p", {}, `This view contains no positioner and no target with the id ${text}. Targets without a ` +
        "positioner are in the view only if an idle positioner reaches them."));
    }
    if (!found.length) return;
    this.choose(found[0][0]);
    this.found = [...new Set(found.map(([k]) => k))];
    const sentences = found.map(([, words]) => make("p", { class: "why" }, words));
    this.panel.replaceChildren(...sentences, ...this.found.flatMap((k) => this.card(k, true)));
    const [xs, ys] = [this.found.map((k) => this.x[k]), this.found.map((k) => this.y[k])];
    const around = 4 * this.outer[this.selected];
    this.stage.fit([Math.min(...xs) - around, Math.min(...ys) - around, Math.max(...xs) + around, Math.max(...ys) + around]);
  }

  // Select the positioner whose center is closest to a point.
  findPlace(x, y) {
    const k = nearest(this.x, this.y, x, y);
    if (k < 0) return this.panel.replaceChildren(make("p", {}, "The position is far from the field."));
    const apart = Math.hypot(this.x[k] - x, this.y[k] - y);
    this.choose(k);
    this.panel.prepend(make("p", { class: "why" }, `${this.where(x, y)}: ${fixed(apart, 2)} mm from the center of this positioner${apart > this.outer[k] ? ", out of its reach" : ""}.`));
    return this.stage.show(this.x[k], this.y[k], 30 / this.outer[k]);
  }

  // ---- differences

  change(k) {
    const [a, b] = [this.plan.target_id[k], this.compared.target_id[k]];
    return a === b ? "same" : !b ? "first" : !a ? "second" : "other";
  }

  changeName(kind) {
    if (kind === "first") return `target only in the plan ${this.plan.name}`;
    return kind === "second" ? `target only in the plan ${this.compared.name}` : CHANGES[kind][0];
  }

  // ---- selection

  pick(x, y) {
    let best = -1, least = 10 / this.stage.scale;
    const { plan } = this;
    for (let k = 0; k < this.n; k += 1) {
      if (!this.visible[k] || Math.abs(this.x[k] - x) > this.outer[k] + least || Math.abs(this.y[k] - y) > this.outer[k] + least) continue;
      let distance = Math.hypot(this.x[k] - x, this.y[k] - y);
      if (Number.isFinite(plan.tip_x[k]) && this.outer[k] * this.stage.scale > ARMS_FROM) {
        distance = Math.min(distance, fromSegment(x, y, this.x[k], this.y[k], plan.elbow_x[k], plan.elbow_y[k]),
          fromSegment(x, y, plan.elbow_x[k], plan.elbow_y[k], plan.tip_x[k], plan.tip_y[k]));
      }
      if (distance < least) [best, least] = [k, distance];
    }
    return best;
  }

  where(x, y) {
    const place = this.data.sky ? this.toSky(x, y) : null;
    return `x ${fixed(x, 2)}, y ${fixed(y, 2)} mm${place ? `; ra ${fixed(place[0], 4)}\u00b0, dec ${fixed(place[1], 4)}\u00b0` : ""}`;
  }

  why(k, plan = this.plan) {
    if (plan.target_id[k]) return [];
    if (!plan.reason[k]) return plan.idle ? [] : ["The given plan assigns no target to this positioner."];
    const [code, inReach, free] = plan.reason[k];
    const targets = plan.free.get(k) ?? [];
    const names = (list) => list.slice(0, 5).map(([name]) => name).join(", ") + (list.length > 5 ? ` and ${list.length - 5} more` : "");
    if (code === 0) return ["Idle: the positioner is disabled."];
    if (code === 1) return ["Idle: the positioner is stuck."];
    if (code === 2) return ["Idle: no target in reach."];
    if (code === 3) return [inReach === 1 ? "Idle: the only target in reach is assigned to another positioner." :
      `Idle: all ${inReach} targets in reach are assigned to other positioners.`];
    if (code === 5) {
      const possible = targets.filter(([, , , , ok]) => ok);
      return [`Idle, although ${plural(possible.length, "free target")} in reach can be observed without a collision while all other arms ` +
        `remain as they are: ${names(possible)}. The allocator did not assign ${possible.length === 1 ? "it" : "them"}.`];
    }
    return [`Idle: at ${free === 1 ? "the only free target" : `each of the ${free} free targets`} in reach, the arm would collide.`,
      ...targets.slice(0, 8).map(([name, , , , , others]) => `Target ${name}: the arm would collide with ${others.split(" ").join(", ")}.`)];
  }

  facts(k, plan) {
    return list([
      ["Target", plan.target_id[k] || "none"], ["Kind", plan.target_id[k] ? plan.kind?.[k] ?? "" : ""],
      ["Status", plan.status[k].replaceAll("_", " ")],
      ["theta, phi", Number.isFinite(plan.theta[k]) ? `${fixed(plan.theta[k], 2, "\u00b0")}, ${fixed(plan.phi[k], 2, "\u00b0")}` : ""],
      ["Clearance", Number.isFinite(plan.clearance[k]) ? fixed(plan.clearance[k], 3, " mm") : ""],
      ["Collides with", plan.colliding_with[k].split(" ").join(", ")],
    ]);
  }

  card(k, long = false) {
    const parts = [make(long ? "h3" : "p", {}, make("strong", {}, `Positioner ${this.id[k]}`))];
    for (const plan of this.compared ? [this.plan, this.compared] : [this.plan]) {
      if (this.compared) parts.push(make("p", {}, plan.name));
      parts.push(this.facts(k, plan));
      const sentences = this.why(k, plan);
      parts.push(...(long ? sentences : sentences.slice(0, 1)).map((text) => make("p", { class: "why" }, text)));
    }
    return parts;
  }

  choose(k, show = true) {
    this.selected = k;
    this.found = [];
    const hint = "Click a positioner, or search for its id, to see its target, its angles, its clearance, and why it is idle.";
    this.panel.replaceChildren(...(k < 0 ? [make("p", {}, hint)] : this.card(k, true)));
    if (this.details.open) this.table?.mark(k, show);
    this.stage.draw();
  }

  step(dx, dy) { this.stage.step(this.x, this.y, this.selected, dx, dy, (k) => this.visible[k]); }

  // ---- table

  tableBox() {
    this.details = make("details", { ontoggle: () => this.details.open && !this.table && this.fillTable() }, make("summary", {}, "All assignments"));
    this.scroll = make("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "All assignments" });
    this.note = make("p", { class: "count" });
    this.details.append(this.note, this.scroll);
    noteHiddenColumns(this.scroll);
    return this.details;
  }

  columns() {
    const { plan } = this;
    const number = (name, unit, decimals) => ({ name: name.replace("_", " "), unit, text: (k) => fixed(plan[name][k], decimals), value: (k) => plan[name][k] });
    const text = (name, values) => ({ name, unit: "", text: (k) => values[k] });
    const shown = (value) => (Number.isNaN(value) ? "" : String(value));
    const others = ["kind", "fiber_type", "spectrograph", "category", "priority"].filter((name) => plan[name] && !("c" in plan.has[name]));
    return [
      text("id", this.id), text("target id", plan.target_id), text("status", plan.status.map((word) => word.replaceAll("_", " "))),
      ...others.map((name) => ({ ...text(name.replace("_", " "), plan[name].map(shown)),
        ...(plan[name].every((v) => typeof v === "number") && { value: (k) => plan[name][k] }) })),
      number("ra", "deg", 6), number("dec", "deg", 6), number("tip_x", "mm", 3), number("tip_y", "mm", 3),
      number("theta", "deg", 3), number("phi", "deg", 3), number("clearance", "mm", 3), text("colliding with", plan.colliding_with),
      text("why idle", this.id.map((_, k) => this.why(k)[0] ?? "")),
    ];
  }

  fillTable() {
    if (this.table?.plan !== this.plan) {
      this.table = new LongTable(this.scroll, this.columns(), { n: this.n, label: "Positioner", choose: (k) => this.fromTable(k) });
      this.table.plan = this.plan;
    }
    const rows = this.id.map((_, k) => k).filter((k) => this.visible[k]);
    const shown = this.data.max_rows === null ? rows : rows.slice(0, this.data.max_rows);
    this.note.textContent = shown.length < rows.length ? `Shown: ${shown.length} of ${plural(rows.length, "row")}.` : plural(rows.length, "row") + ".";
    this.table.show(shown);
    this.scroll.dispatchEvent(new Event("scroll")); // updates the note on hidden columns
    this.table.mark(this.selected, true);
  }

  fromTable(k) {
    this.choose(k, false);
    this.stage.show(this.x[k], this.y[k], 70 / this.outer[k]);
  }

  enter() { openRow(this); }
}
VIEWS.focal_plane = FocalPlaneView;

function fromSegment(x, y, ax, ay, bx, by) {
  const [dx, dy] = [bx - ax, by - ay];
  const t = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(ax + t * dx - x, ay + t * dy - y);
}
