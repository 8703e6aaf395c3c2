// The focal plane of a tile whose arms move from the folded poses to the plan: along paths, or all at constant rates.

const BEYOND = 1; // mm: distances that exceed the minimum separation by more than this are not distinguished
const RATES = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20]; // choices of the speed: seconds of the motion per second
const PLAYED = 10; // seconds that the motion takes at the default speed
const POSES = ["elbow_x", "elbow_y", "tip_x", "tip_y", "arm_x", "arm_y"];

// Return the nonnegative integers that report/_motion.py packed.
function unpackIntegers(text) {
  const bytes = atob(text), values = [];
  for (let i = 0, value = 0, unit = 1; i < bytes.length; i += 1) {
    const byte = bytes.charCodeAt(i);
    value += (byte & 127) * unit;
    unit *= 128;
    if (byte < 128) {
      values.push(value);
      [value, unit] = [0, 1];
    }
  }
  return values;
}

// The distance of two convex polygons, 0 if they overlap. Both are in a list of counterclockwise corners x0, y0, x1, ...: n corners
// from the index i, and m corners from the index j. A polygon with two corners is a segment, and one with one corner is a point.
function betweenPolygons(list, i, n, j, m) {
  const side = (ax, ay, bx, by, x, y) => (bx - ax) * (y - ay) - (by - ay) * (x - ax); // positive on the left of the line from a to b
  let least = Infinity, inFirst = n > 2, inSecond = m > 2;
  for (let p = 0; p < n; p += 1) {
    const a = i + 2 * p, b = i + 2 * ((p + 1) % n), ax = list[a], ay = list[a + 1], bx = list[b], by = list[b + 1];
    inFirst &&= side(ax, ay, bx, by, list[j], list[j + 1]) >= 0;
    for (let q = 0; q < m; q += 1) {
      const c = j + 2 * q, d = j + 2 * ((q + 1) % m), cx = list[c], cy = list[c + 1], dx = list[d], dy = list[d + 1];
      const left = side(cx, cy, dx, dy, ax, ay);
      if (p === 0) inSecond &&= left >= 0;
      if (left * side(cx, cy, dx, dy, bx, by) < 0 && side(ax, ay, bx, by, cx, cy) * side(ax, ay, bx, by, dx, dy) < 0) return 0;
      least = Math.min(least, fromSegment(ax, ay, cx, cy, dx, dy), fromSegment(cx, cy, ax, ay, bx, by));
    }
  }
  return inFirst || inSecond ? 0 : least;
}

// The poses of all arms at a time, and the distances of neighboring arms.
class Motion {
  constructor(data, x, y, separation) {
    const n = x.length, numbers = (size, value = 0) => new Float64Array(size).fill(value);
    Object.assign(this, { data, n, x, y, separation, planned: true, frame: 0 });
    for (const [name, column] of Object.entries(data.sizes)) this[name] = Float64Array.from(unpack(column, n));
    for (const name of [...POSES, "theta", "psi"]) this[name] = numbers(n, NaN);
    this.readKnots(unpackIntegers(data.knots), numbers);
    [this.stamp, this.shaped] = [0, 0].map(() => new Int32Array(n).fill(-1)); // frames in which poses and shapes were computed
    [this.knot, this.close] = [this.start.slice(), new Uint8Array(n)];
    // largest distance of a point of an arm from the center, and largest speed of a point in both motions
    this.far = this.l1.map((l1, k) => Math.max(l1 + this.reach[k], data.central));
    this.speed = this.far.map((_, k) => this.speedOf(k));
    // largest error (mm) of the distance of two arms, because angles and times are rounded
    const turned = Math.PI / 360 / data.per_deg;
    this.error = 2 * this.far.reduce((most, far, k) => Math.max(most, turned * (far + this.reach[k]) + 0.5 / data.per_second * this.speed[k]), 0);
    // without outlines, the only part of an arm is a segment; the last corner of each part is its center
    this.segment = !data.parts.length;
    this.size = 0; // of the corners of an arm
    this.parts = (this.segment ? [[[[0, 0], [1, 0]], 0]] : data.parts).map(([corners, radius], part) => {
      const center = [0, 1].map((axis) => corners.reduce((sum, corner) => sum + corner[axis], 0) / corners.length), begin = this.size;
      const around = radius + Math.max(...corners.map(([u, v]) => Math.hypot(u - center[0], v - center[1]))) * (this.segment ? Math.max(...this.length) : 1);
      this.size += 2 * corners.length + 2;
      return { corners: [...corners, center], n: corners.length, radius, around, begin, eccentric: this.segment || part < data.n_eccentric };
    });
    this.corners = numbers(n * this.size, NaN);
    this.pairs = this.neighbors();
    [this.seen, this.known, this.slack] = [0, 0, 0].map(() => numbers(this.pairs.length / 2));
    this.at(data.duration);
    this.reset();
  }

  readKnots(values, numbers) {
    const { n, data: { duration, per_second, per_deg } } = this;
    this.start = new Int32Array(n + 1);
    for (let k = 0; k < n; k += 1) this.start[k + 1] = this.start[k] + values[k];
    [this.times, this.thetas, this.phis] = [0, 0, 0].map(() => numbers(this.start[n]));
    let next = n;
    for (let k = 0; k < n; k += 1) {
      const last = this.start[k + 1] - 1;
      for (let m = this.start[k] + 1, time = 0; m < last; m += 1, next += 1) this.times[m] = (time += values[next]) / per_second;
      if (last > this.start[k]) this.times[last] = duration;
    }
    for (const angles of [this.thetas, this.phis]) {
      for (let k = 0, begin = 0; k < n; k += 1) {
        for (let m = this.start[k], angle = begin; m < this.start[k + 1]; m += 1, next += 1) {
          angle += values[next] % 2 ? -(values[next] + 1) / 2 : values[next] / 2;
          if (m === this.start[k]) begin = angle;
          angles[m] = angle * Math.PI / 180 / per_deg;
        }
      }
    }
  }

  speedOf(k) {
    let largest = 0;
    for (let m = this.start[k] + 1; m < this.start[k + 1]; m += 1) {
      const [theta, phi] = [this.thetas, this.phis].map((angles) => angles[m] - angles[m - 1]);
      const seconds = Math.max(this.times[m] - this.times[m - 1], 1 / this.data.per_second);
      largest = Math.max(largest, (this.far[k] * Math.abs(theta) + this.reach[k] * Math.abs(theta + phi)) / seconds);
    }
    return largest;
  }

  // Pairs of positioners whose arms can come closer than the minimum separation plus BEYOND, without pairs of broken arms.
  neighbors() {
    const { n, x, y, far } = this, ahead = this.separation + BEYOND, most = far.reduce((a, b) => Math.max(a, b), 0) + ahead;
    const order = Array.from(x.keys()).sort((i, j) => x[i] - x[j]), fixed = new Set(this.data.fixed), pairs = [];
    order.forEach((i, k) => {
      for (let m = k + 1; m < n && x[order[m]] - x[i] < far[i] + most; m += 1) {
        const j = order[m], apart = Math.hypot(x[i] - x[j], y[i] - y[j]);
        if (apart < far[i] + far[j] + ahead && !(fixed.has(i) && fixed.has(j))) pairs.push(i, j);
      }
    });
    return Int32Array.from(pairs);
  }

  // Forget the distances at former times.
  reset() {
    Object.assign(this, { smallest: this.separation + BEYOND, pair: -1, when: 0, now: 0, total: 0 });
    this.seen.fill(0); // 1 for pairs that were closer than the minimum separation
    this.known.fill(NaN); // time at which the distance of a pair was computed, which need not be repeated for slack seconds
  }

  at(time) {
    this.time = Math.min(Math.max(time, 0), this.data.duration);
    this.frame += 1;
  }

  // Compute the pose of an arm at the present time: between two break points, both joints rotate at constant rates.
  place(k) {
    const { times, thetas, phis, time } = this, first = this.start[k], last = this.start[k + 1] - 1;
    if (this.stamp[k] === this.frame || last < first) return; // an arm without break points is absent
    this.stamp[k] = this.frame;
    let from = first, to = last;
    if (this.planned) {
      from = this.knot[k];
      while (from > first && times[from] > time) from -= 1;
      while (from < last - 1 && times[from + 1] <= time) from += 1;
      this.knot[k] = from;
      to = from + 1;
    }
    const seconds = times[to] - times[from], part = seconds ? (time - times[from]) / seconds : 1;
    const theta = thetas[from] + part * (thetas[to] - thetas[from]), psi = theta + phis[from] + part * (phis[to] - phis[from]);
    const fiber = psi - this.offset[k] * Math.PI / 180;
    this.theta[k] = theta;
    this.psi[k] = psi;
    this.elbow_x[k] = this.x[k] + this.l1[k] * Math.cos(theta);
    this.elbow_y[k] = this.y[k] + this.l1[k] * Math.sin(theta);
    this.tip_x[k] = this.elbow_x[k] + this.l2[k] * Math.cos(fiber);
    this.tip_y[k] = this.elbow_y[k] + this.l2[k] * Math.sin(fiber);
    this.arm_x[k] = this.elbow_x[k] + this.length[k] * Math.cos(psi);
    this.arm_y[k] = this.elbow_y[k] + this.length[k] * Math.sin(psi);
  }

  // Compute the corners of the parts of an arm in the coordinates of the focal plane.
  shape(k) {
    this.place(k);
    if (this.shaped[k] === this.frame) return;
    this.shaped[k] = this.frame;
    let next = k * this.size;
    for (const { corners, eccentric } of this.parts) {
      const angle = eccentric ? this.psi[k] : this.theta[k], c = Math.cos(angle), s = Math.sin(angle);
      const x = eccentric ? this.elbow_x[k] : this.x[k], y = eccentric ? this.elbow_y[k] : this.y[k];
      for (let corner = 0; corner < corners.length; corner += 1, next += 2) {
        const [p, v] = corners[corner], u = this.segment ? this.inner[k] + p * (this.length[k] - this.inner[k]) : p;
        this.corners[next] = x + c * u - s * v;
        this.corners[next + 1] = y + s * u + c * v;
      }
    }
  }

  // The distance of two arms; instead of a distance above the given limit, a smaller distance above the limit can be returned.
  distance(i, j, limit) {
    this.shape(i);
    this.shape(j);
    const { corners, size } = this;
    let least = Infinity;
    for (const a of this.parts) for (const b of this.parts) {
      if (!a.eccentric && !b.eccentric) continue;
      const p = i * size + a.begin, q = j * size + b.begin, u = p + 2 * a.n, v = q + 2 * b.n;
      const apart = Math.hypot(corners[u] - corners[v], corners[u + 1] - corners[v + 1]) - a.around - b.around;
      if (apart >= least) continue;
      least = Math.min(least, apart > limit ? apart : betweenPolygons(corners, p, a.n, q, b.n) - a.radius - b.radius);
    }
    return least;
  }

  // Find the arms that are closer than the minimum separation, and update the smallest distance since the last reset. A distance
  // changes at most by the sum of the largest speeds of both arms, so that few distances are computed.
  measure() {
    const { pairs, known, slack, separation, time, speed } = this, least = Math.max(this.smallest, separation);
    this.close.fill(0);
    this.now = 0;
    for (let p = 0; p < known.length; p += 1) {
      if (Math.abs(time - known[p]) < slack[p]) continue;
      const i = pairs[2 * p], j = pairs[2 * p + 1], fast = speed[i] + speed[j], distance = this.distance(i, j, least + fast * this.data.duration / 300);
      known[p] = time;
      slack[p] = (distance - least) / fast;
      if (distance < this.smallest) Object.assign(this, { smallest: distance, pair: p, when: time });
      if (!(distance < separation - this.error)) continue;
      this.close[i] = this.close[j] = 1;
      this.now += 1;
      this.total += 1 - this.seen[p];
      this.seen[p] = 1;
    }
  }
}

class MovingFocalPlane extends FocalPlaneView {
  // ---- controls

  tools() {
    const { data } = this, { duration, per_second } = data.motion;
    const motion = this.motion = new Motion(data.motion, this.x, this.y, data.separation);
    this.posed = Object.assign(Object.create(this.plan), Object.fromEntries(POSES.map((name) => [name, motion[name]])));
    const [kind] = select("Motion", [["", [["planned", "planned paths"], ["constant", "all joints at constant rates"]]]], (event) => {
      motion.planned = event.target.value === "planned";
      motion.reset();
      this.show(motion.time);
    });
    const [speed, speedBox] = select("Speed", [["", RATES.map((value) => [value, `${value} \u00d7`])]], () => {});
    const misfit = (rate) => Math.abs(Math.log(rate * PLAYED / duration));
    speedBox.value = RATES.reduce((a, b) => (misfit(b) < misfit(a) ? b : a));
    this.rate = () => +speedBox.value;
    this.button = make("button", { type: "button", onclick: () => (this.playing ? this.pause() : this.play()) });
    this.clock = make("span");
    const step = 10 ** Math.floor(Math.log10(duration / 100));
    this.slider = make("input", { type: "range", min: 0, max: Math.ceil(duration / step) * step, step, "aria-label": "Time",
      oninput: () => { this.pause(); this.show(+this.slider.value); } });
    this.distances = make("span");
    [this.button.style.minWidth, this.clock.style.fontVariantNumeric] = ["5rem", "tabular-nums"];
    const about = "The arms move from the folded poses to the plan. At constant rates, each joint rotates during the whole time, without planned paths. " +
      `Distances are those of ${motion.segment ? "the axes of two arms (lines in the centers of the bands)" : "the outlines of two arms"}; ` +
      `obstacles are not considered. Angles are rounded to ${1 / data.motion.per_deg}\u00b0, and times to ${1 / per_second} s, which changes distances by at most ` +
      `${motion.error.toFixed(3)} mm. The paths are proven without rounding.`;
    this.motionBox = make("div", { role: "group", "aria-label": "Motion of the arms" },
      make("div", { class: "tools" }, kind, this.button, make("label", { class: "field" }, this.clock, this.slider), speed));
    this.stage.help.append(" ", this.distances, ` ${about}`);
    this.motionBox.style.marginBottom = "0.75rem";
    return make("div", {}, super.tools(), this.motionBox);
  }

  // The paths belong to the first plan; differences of plans are shown without motion.
  update() {
    this.moving = this.plan === this.plans[0] && !this.compared;
    this.motionBox.hidden = !this.moving;
    this.pause();
    this.show(this.motion.time);
    super.update();
  }

  play() {
    const { motion } = this;
    if (motion.time >= motion.data.duration) this.show(0);
    this.playing = true;
    this.button.textContent = "Pause";
    let last = null;
    const tick = (now) => {
      if (!this.playing) return;
      this.show(motion.time + (last === null ? 0 : Math.min(now - last, 100) / 1000 * this.rate()));
      last = now;
      if (motion.time >= motion.data.duration) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.playing = false;
    this.button.textContent = "Play";
  }

  // Show the arms at a time. The smallest distance is that of the times that were shown since the time 0 was shown.
  show(time) {
    const { motion } = this;
    motion.at(time);
    if (motion.time === 0) motion.reset();
    motion.measure();
    this.slider.value = motion.time;
    this.slider.setAttribute("aria-valuetext", `${motion.time.toFixed(2)} s`);
    this.clock.textContent = `Time: ${motion.time.toFixed(2)} s of ${motion.data.duration.toFixed(2)} s`;
    this.distances.textContent = this.sentences();
    this.stage.draw();
  }

  sentences() {
    const { motion: { separation, pair, pairs, smallest, when, now, total }, id } = this;
    const least = pair < 0 ? `more than ${fixed(separation + BEYOND, 2)} mm` :
      `${fixed(Math.max(smallest, 0), 2)} mm (positioners ${id[pairs[2 * pair]]} and ${id[pairs[2 * pair + 1]]}, at ${fixed(when, 2)} s)`;
    return `Smallest distance of two arms at the times shown so far: ${least}; minimum separation: ${fixed(separation, 2)} mm. ` +
      `Closer than the minimum separation: ${plural(now, "pair")} of arms now, ${total} so far.`;
  }

  fillLegend() {
    super.fillLegend();
    if (!this.moving) return;
    const more = make("ul");
    fillLegend(more, [["closer than the minimum separation at this time", "var(--c-collision)", "diamond"]]);
    this.legend.append(...more.children);
  }

  // ---- drawing

  colorName(k) { return this.moving && this.motion.close[k] ? "c-collision" : super.colorName(k); }

  symbol(k, plan) { return this.moving && this.motion.close[k] ? "diamond" : super.symbol(k, plan); }

  paint(context, stage) { this.withPoses(() => super.paint(context, stage)); }

  pick(x, y) { return this.withPoses(() => super.pick(x, y)); }

  withPoses(action) {
    const { plan } = this;
    if (this.moving) this.plan = this.posed;
    const result = action();
    this.plan = plan;
    return result;
  }

  paintArms(context, stage, rows, plan) {
    if (this.moving) for (const k of rows) this.motion.place(k);
    super.paintArms(context, stage, rows, plan);
  }

  // Dots are drawn in an image, because thousands of circles are drawn slowly.
  paintDots(context, stage, rows) {
    if (!this.moving) return super.paintDots(context, stage, rows);
    const { plan, motion } = this, { width, height } = stage.canvas, { tip_x, tip_y } = plan, ratio = width / stage.width, scale = ratio * stage.scale;
    const size = Math.max(1.6, Math.min(3.5, this.outer[0] * stage.scale * 0.5)), wide = Math.round(2 * size * ratio);
    if (this.image?.width !== width || this.image.height !== height) {
      this.image = context.createImageData(width, height);
      this.layer = make("canvas", { width, height });
    }
    const pixels = new Uint32Array(this.image.data.buffer).fill(0), others = [];
    const radius = wide / 2, indents = Array.from({ length: wide }, (_, row) => Math.round(radius - Math.sqrt(radius ** 2 - (row + 0.5 - radius) ** 2)));
    const rgb = parseInt(context.fillStyle.slice(1), 16), color = (0xff000000 | (rgb & 255) << 16 | rgb & 0xff00 | rgb >> 16) >>> 0;
    const [left, top] = [(width - wide) / 2 - stage.flip * stage.x * scale, (height - wide) / 2 + stage.y * scale];
    for (const k of rows) {
      if (motion.close[k] || !plan.target_id[k] || this.symbol(k, plan) !== "dot") {
        others.push(k);
        continue;
      }
      motion.place(k);
      const x = Math.round(left + stage.flip * scale * tip_x[k]), y = Math.round(top - scale * tip_y[k]);
      for (let row = Math.max(-y, 0); row < Math.min(wide, height - y); row += 1) {
        const begin = (y + row) * width, end = Math.min(x + wide - indents[row], width);
        for (let u = Math.max(x + indents[row], 0); u < end; u += 1) pixels[begin + u] = color;
      }
    }
    this.layer.getContext("2d").putImageData(this.image, 0, 0);
    context.drawImage(this.layer, 0, 0, stage.width, stage.height);
    context.lineWidth = 1;
    return this.paintSymbols(context, stage, others, plan, (k) => [this.x[k], this.y[k]], size);
  }
}
VIEWS.motion = MovingFocalPlane;
