// A calculator with sliders. It computes the collision probability of a design with the surrogate of probability/_surrogate.py.

// The index of the first cubic B-spline that is not 0 at x, and the values of this spline and of the next three (de Boor's recurrence).
function basis(knots, x) {
  let last = knots.length - 5;
  while (last > 3 && x < knots[last]) last -= 1;
  const values = [1, 0, 0, 0];
  for (let degree = 1; degree <= 3; degree += 1) {
    let saved = 0;
    for (let k = 0; k < degree; k += 1) {
      const [right, left] = [knots[last + k + 1], knots[last + 1 - degree + k]];
      const part = values[k] / (right - left);
      values[k] = saved + (right - x) * part;
      saved = (x - left) * part;
    }
    values[degree] = saved;
  }
  return [last - 3, values];
}

class Surrogate {
  constructor(data) {
    Object.assign(this, data);
    const [a, b, c] = data.shape;
    this.values = unpack(data.coefficients, a * b * c);
  }

  // Sentences on the parameters of a design that are outside the range of the surrogate.
  problems({ central_arm, eccentric_arm, pitch, clearance }) {
    const point = [central_arm / pitch, eccentric_arm / central_arm, 2 * clearance / pitch];
    return this.axes.flatMap(([name, low, high], k) => (point[k] >= low - 1e-9 * high && point[k] <= high + 1e-9 * high ? [] :
      [`${name} must be from ${low} to ${high}; it is ${fixed(point[k], 3)}`]));
  }

  probability({ central_arm, eccentric_arm, pitch, clearance }) {
    if (pitch > 2 * (central_arm + eccentric_arm) + 2 * clearance) return 0;
    const point = [central_arm / pitch, eccentric_arm / central_arm, 2 * clearance / pitch]
      .map((v, k) => Math.min(Math.max(v, this.axes[k][1]), this.axes[k][2]));
    const [first, second, third] = point.map((v, k) => basis(this.knots[k], v));
    let sum = 0;
    for (let i = 0; i < 4; i += 1) for (let j = 0; j < 4; j += 1) for (let k = 0; k < 4; k += 1) {
      const at = ((first[0] + i) * this.shape[1] + second[0] + j) * this.shape[2] + third[0] + k;
      sum += first[1][i] * second[1][j] * third[1][k] * this.values[at];
    }
    return Math.min(Math.max(sum, 0), 1);
  }
}

const SLIDERS = [["central_arm", "central arm"], ["eccentric_arm", "eccentric arm"], ["pitch", "pitch"], ["clearance", "clearance"]];
const STEPS = [["eccentric_arm", 1], ["eccentric_arm", -1], ["central_arm", 1], ["central_arm", -1], ["pitch", 1], ["pitch", -1], ["clearance", 0.1], ["clearance", -0.1]];

class CalculatorView {
  constructor(live, data) {
    this.surrogate = new Surrogate(data);
    this.design = { ...data.start };
    this.varied = "eccentric_arm";
    this.inputs = {};
    const fields = SLIDERS.map(([name, words]) => this.slider(name, words, data.start[name]));
    this.result = make("div", { class: "result", role: "status" });
    this.steps = make("table", { class: "facts" });
    this.canvas = make("canvas", { class: "curve", role: "img" });
    live.append(make("div", { class: "calculator" }, make("div", {}, ...fields), make("div", {}, this.result, this.canvas, this.steps)));
    document.addEventListener("design", ({ detail }) => this.set(detail));
    new ResizeObserver(() => this.curve()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.curve());
    this.update();
  }

  slider(name, words, value) {
    const [low, high] = name === "clearance" ? [0, Math.max(6, 2 * value)] : [Math.max(0.5, value * 0.4), value * 2];
    const slider = make("input", { type: "range", min: low.toFixed(2), max: high.toFixed(2), step: 0.01, "aria-label": `${words} in mm` });
    const number = make("input", { type: "number", min: 0, step: 0.01, "aria-label": `${words} in mm, as a number` });
    for (const input of [slider, number]) input.addEventListener("input", () => {
      if (!(input.valueAsNumber > 0 || (name === "clearance" && input.valueAsNumber === 0))) return;
      this.varied = name;
      this.set({ [name]: input.valueAsNumber }, input);
    });
    this.inputs[name] = [slider, number];
    return make("div", { class: "slide" }, make("span", { "aria-hidden": "true" }, `${words} [mm]`), slider, number);
  }

  set(values, source = null) {
    Object.assign(this.design, values);
    this.update(source);
  }

  update(source = null) {
    for (const [name, [slider, number]] of Object.entries(this.inputs)) {
      const value = this.design[name];
      if (slider !== source) {
        if (value > +slider.max) slider.max = value;
        if (value < +slider.min) slider.min = value;
        slider.value = value;
      }
      if (number !== source) number.value = +value.toFixed(4);
    }
    const { central_arm: l1, eccentric_arm: l2, pitch, clearance } = this.design;
    const cell = Math.sqrt(3) / 2 * pitch ** 2;
    const problems = this.surrogate.problems(this.design);
    const p = this.surrogate.probability(this.design);
    const error = p === 0 ? 0 : this.surrogate.error;
    this.result.replaceChildren(
      make("p", { class: "kind" }, "Collision probability"),
      make("p", { class: "large" }, problems.length ? "\u2013" : fixed(p, 4)),
      make("p", { class: problems.length ? "bad" : "count" }, problems.length ? `Outside the range of the surrogate: ${problems.join("; ")}.` :
        p === 0 ? "The arms cannot touch." : `Errors of the surrogate: root mean square ${error}, largest known error ${this.surrogate.largest_error}.`),
      list([["Radii of the patrol area", `${fixed(Math.abs(l1 - l2), 2)} to ${fixed(l1 + l2, 2)} mm`], ["Minimum separation", fixed(2 * clearance, 2, " mm")],
        ["Patrol area divided by area per positioner", fixed(Math.PI * 4 * l1 * l2 / cell, 3)],
        ["Positioners per cm\u00b2", fixed(100 / cell, 4)]]));
    this.fillSteps(problems.length ? null : p);
    this.curve();
  }

  // The changes of the collision probability if one length changes slightly.
  fillSteps(p) {
    const rows = STEPS.map(([name, step]) => {
      const changed = { ...this.design, [name]: this.design[name] + step };
      const valid = p !== null && changed[name] > 0 && !this.surrogate.problems(changed).length;
      const change = valid ? this.surrogate.probability(changed) - p : NaN;
      const sign = (v, digits) => `${v < 0 ? "" : "+"}${fixed(v, digits)}`;
      return make("tr", {}, make("th", { scope: "row" }, `${name.replace("_", " ")} ${sign(step, Math.abs(step) < 1 ? 1 : 0)} mm`),
        make("td", { class: "number" }, valid ? sign(change, 4) : "outside the range"));
    });
    this.steps.replaceChildren(make("caption", {}, "Change of the collision probability"), make("tbody", {}, ...rows));
  }

  // The probability as a function of the parameter that was changed last, within the range of the surrogate.
  curve() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width) return;
    const ratio = devicePixelRatio || 1;
    [this.canvas.width, this.canvas.height] = [width * ratio, height * ratio];
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    const [slider] = this.inputs[this.varied];
    const [low, high] = [+slider.min, +slider.max];
    const points = [];
    for (let k = 0; k <= 120; k += 1) {
      const value = low + (high - low) * k / 120;
      const design = { ...this.design, [this.varied]: value };
      if (value > 0 && !this.surrogate.problems(design).length) points.push([value, this.surrogate.probability(design)]);
    }
    const words = SLIDERS.find(([name]) => name === this.varied)[1];
    const color = (name) => getComputedStyle(this.canvas).getPropertyValue(`--${name}`).trim();
    const top = Math.max(0.05, ...points.map(([, p]) => p)) * 1.1;
    const at = (x, p) => [44 + (width - 56) * (x - low) / (high - low), height - 30 - (height - 42) * p / top];
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = color("ink");
    context.strokeStyle = color("faint");
    for (const p of [0, top / 2, top]) {
      context.beginPath();
      context.moveTo(...at(low, p));
      context.lineTo(...at(high, p));
      context.stroke();
      context.fillText(p.toFixed(2), 8, at(low, p)[1] + 4);
    }
    context.fillText(low.toFixed(1), 40, height - 10);
    context.textAlign = "right";
    context.fillText(high.toFixed(1), width - 10, height - 10);
    context.textAlign = "center";
    context.fillText(`${words} [mm]`, width / 2, height - 10);
    context.strokeStyle = color("c-arm");
    context.lineWidth = 2;
    context.beginPath();
    points.forEach(([x, p], k) => (k ? context.lineTo(...at(x, p)) : context.moveTo(...at(x, p))));
    context.stroke();
    if (!this.surrogate.problems(this.design).length) {
      context.fillStyle = color("c-collision");
      context.beginPath();
      context.arc(...at(this.design[this.varied], this.surrogate.probability(this.design)), 5, 0, 2 * Math.PI);
      context.fill();
    }
    const ends = points.length ? `from ${fixed(points[0][0], 2)} to ${fixed(points[points.length - 1][0], 2)} mm` : "for no value";
    this.canvas.setAttribute("aria-label", `Collision probability as a function of the ${words}; the surrogate is valid ${ends}.`);
  }
}
VIEWS.calculator = CalculatorView;
