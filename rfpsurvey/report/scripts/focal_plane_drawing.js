// The drawing of a focal plane: dots or arms, obstacles, the selection, and the compass.

const STATES = {
  science: ["science target", "c-arm"], standard: ["standard star", "c-star"], sky: ["blank sky", "c-sky"],
  collision: ["in collision", "c-collision", "diamond"], struck: ["in collision, not counted (disabled, stuck or at a recorded pose)", "c-obstacle", "diamond"], reach: ["target out of reach", "c-other"], idle: ["no target", "c-idle", "ring"],
  unusable: ["disabled or stuck", "c-obstacle", "ring"],
};
const CHANGES = { same: ["same target", "c-idle"], other: ["different target", "c-star"], first: ["", "c-arm"], second: ["", "c-other"] };
const ARMS_FROM = 9; // pixels: arms are drawn if the radius of a patrol area is larger

class FocalPlaneDrawing {
  colorName(k) {
    return this.compared ? CHANGES[this.change(k)][1] : STATES[this.plan.state[k]][1];
  }

  // The symbol of a positioner, in the drawing and in the legend: a diamond, a ring without a target, or a dot.
  symbol(k, plan) {
    if (!this.compared) return STATES[plan.state[k]][2] ?? "dot";
    return plan.target_id[k] ? "dot" : "ring";
  }

  paint(context, stage) {
    const [ax, ay] = stage.toWorld(0, stage.height), [bx, by] = stage.toWorld(stage.width, 0);
    const rows = [];
    for (let k = 0; k < this.n; k += 1) {
      const r = this.outer[k];
      if (this.x[k] + r > Math.min(ax, bx) && this.x[k] - r < Math.max(ax, bx) && this.y[k] + r > ay && this.y[k] - r < by) rows.push(k);
    }
    this.paintObstacles(context, stage);
    const groups = new Map();
    for (const k of rows) {
      const name = this.visible[k] ? this.colorName(k) : "faint";
      if (!groups.has(name)) groups.set(name, []);
      groups.get(name).push(k);
    }
    const order = ["faint", "c-idle"];
    const sorted = [...groups].sort(([a], [b]) => (order.includes(b) - order.includes(a)) || (a === "faint" ? -1 : 0));
    const large = this.outer[0] * stage.scale > ARMS_FROM;
    if (large) this.paintPatrol(context, stage, rows);
    for (const [name, members] of sorted) {
      context.fillStyle = context.strokeStyle = stage.color(name);
      if (!large) this.paintDots(context, stage, members);
      else this.paintArms(context, stage, members, this.plan);
    }
    if (this.compared) this.paintCompared(context, stage, sorted, large);
    this.paintSelection(context, stage);
    const compass = this.compass();
    if (compass) paintCompass(context, stage, compass);
    paintScale(context, stage, " mm");
  }

  // The arms of the second plan where they differ, as dashed lines in the color of the difference, and the collisions of both plans.
  paintCompared(context, stage, groups, large) {
    for (const [name, members] of large ? groups : []) {
      const rows = members.filter((k) => this.visible[k] && this.change(k) !== "same");
      context.fillStyle = context.strokeStyle = stage.color(name);
      context.setLineDash([4, 3]);
      this.paintArms(context, stage, rows, this.compared);
      context.setLineDash([]);
    }
    const shown = groups.flatMap(([, members]) => members).filter((k) => this.visible[k]);
    const size = large ? 5 : 4;
    context.fillStyle = context.strokeStyle = stage.color("c-collision");
    context.lineWidth = 1.5;
    for (const [plan, radius] of [[this.plan, size], [this.compared, size + 3]]) {
      context.beginPath();
      for (const k of shown) if (plan.colliding_with[k]) diamond(context, ...stage.toScreen(this.x[k], this.y[k]), radius);
      if (plan === this.plan) context.fill(); else context.stroke();
    }
  }

  paintDots(context, stage, rows) {
    const size = Math.max(1.6, Math.min(3.5, this.outer[0] * stage.scale * 0.5));
    context.lineWidth = 1;
    this.paintSymbols(context, stage, rows, this.plan, (k) => [this.x[k], this.y[k]], size);
  }

  paintPatrol(context, stage, rows) {
    context.strokeStyle = stage.color("c-patrol");
    context.lineWidth = 0.5;
    context.globalAlpha = 0.6;
    context.beginPath();
    for (const k of rows) {
      const [px, py] = stage.toScreen(this.x[k], this.y[k]);
      const r = this.outer[k] * stage.scale;
      context.moveTo(px + r, py);
      context.arc(px, py, r, 0, 2 * Math.PI);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  // Thin lines are the arms; a translucent band is as wide as the minimum separation. Two arms collide if their bands overlap.
  paintArms(context, stage, rows, plan) {
    const path = (points, closed) => {
      context.beginPath();
      for (const k of rows) {
        const [first, ...others] = points(k);
        if (!Number.isFinite(first[0])) continue;
        context.moveTo(...stage.toScreen(...first));
        for (const point of others) context.lineTo(...stage.toScreen(...point));
      }
      if (closed) context.fill(); else context.stroke();
    };
    const tip = (k) => [plan.tip_x[k], plan.tip_y[k]];
    const elbow = (k) => [plan.elbow_x[k], plan.elbow_y[k]];
    const end = (k) => [plan.arm_x?.[k] ?? plan.tip_x[k], plan.arm_y?.[k] ?? plan.tip_y[k]];
    context.lineJoin = context.lineCap = "round";
    if (this.data.arm_model !== "outline") {
      context.lineWidth = Math.max(this.data.separation * stage.scale, 1);
      context.globalAlpha = 0.25;
      const start = this.data.arm_model === "fiber_tip" ? tip : elbow;
      path((k) => [start(k), end(k)]);
    }
    context.globalAlpha = 1;
    context.lineWidth = Math.max(1, Math.min(0.3 * stage.scale, 2.5));
    path((k) => [[this.x[k], this.y[k]], elbow(k), tip(k)]);
    this.paintSymbols(context, stage, rows, plan, (k) => (plan.target_id[k] ? tip(k) : [this.x[k], this.y[k]]), 3);
  }

  paintSymbols(context, stage, rows, plan, place, size) {
    for (const symbol of ["dot", "diamond", "ring"]) {
      context.beginPath();
      for (const k of rows) {
        if (this.symbol(k, plan) !== symbol) continue;
        const [px, py] = stage.toScreen(...place(k));
        if (symbol === "diamond") diamond(context, px, py, 2 * size);
        else {
          context.moveTo(px + size, py);
          context.arc(px, py, size, 0, 2 * Math.PI);
        }
      }
      if (symbol === "ring") context.stroke(); else context.fill();
    }
  }

  paintObstacles(context, stage) {
    context.fillStyle = stage.color("c-obstacle");
    context.globalAlpha = 0.5;
    context.beginPath();
    for (const [x, y, r] of this.data.obstacles) {
      const [px, py] = stage.toScreen(x, y);
      context.moveTo(px + r * stage.scale, py);
      context.arc(px, py, r * stage.scale, 0, 2 * Math.PI);
    }
    for (const polygon of this.data.polygons) {
      polygon.forEach((point, i) => (i ? context.lineTo(...stage.toScreen(...point)) : context.moveTo(...stage.toScreen(...point))));
      context.closePath();
    }
    context.fill();
    context.globalAlpha = 1;
  }

  paintRing(context, stage, k, width) {
    const [px, py] = stage.toScreen(this.x[k], this.y[k]);
    context.lineWidth = width;
    context.strokeStyle = stage.color("c-mark");
    context.beginPath();
    context.arc(px, py, Math.max(this.outer[k] * stage.scale, 7), 0, 2 * Math.PI);
    context.stroke();
  }

  paintHovered(context, stage, k) { this.paintRing(context, stage, k, 1); }

  paintSelection(context, stage) {
    if (this.selected < 0) return;
    for (const k of new Set([this.selected, ...this.found])) this.paintRing(context, stage, k, 2.5);
    for (const [, x, y, , possible] of this.plan.free.get(this.selected) ?? []) { // crosses are free targets
      const [px, py] = stage.toScreen(x, y);
      context.strokeStyle = stage.color(possible ? "c-good" : "c-collision");
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(px - 5, py - 5);
      context.lineTo(px + 5, py + 5);
      context.moveTo(px - 5, py + 5);
      context.lineTo(px + 5, py - 5);
      context.stroke();
    }
  }

  // The tangent plane (rad, toward east and north) at a point of the focal plane: the polynomial of report/_views.py.
  tangent(x, y) {
    const r2 = x * x + y * y, terms = [[x, y], [1, 0], [x * r2, y * r2], [x, -y], [x * r2 * r2, y * r2 * r2]];
    return this.data.sky.terms.reduce(([e, n], [re, im], k) => [e + re * terms[k][0] - im * terms[k][1], n + re * terms[k][1] + im * terms[k][0]], [0, 0]);
  }

  toSky(x, y) {
    const [ra, dec] = this.data.sky.center, [sin, cos] = [Math.sin(dec * Math.PI / 180), Math.cos(dec * Math.PI / 180)];
    const [e, n] = this.tangent(x, y);
    const [east, forward] = [Math.atan2(e, cos - n * sin), Math.hypot(e, cos - n * sin)];
    return [(ra + east * 180 / Math.PI + 360) % 360, Math.atan2(sin + n * cos, forward) * 180 / Math.PI];
  }

  // The inverse of toSky, by iterations with the linear term of the polynomial; points of the other hemisphere are NaN.
  fromSky(ra, dec) {
    const { center, terms: [[re, im]] } = this.data.sky;
    const [east, d, d0] = [ra - center[0], dec, center[1]].map((v) => v * Math.PI / 180);
    const near = Math.sin(d0) * Math.sin(d) + Math.cos(d0) * Math.cos(d) * Math.cos(east);
    const goal = [Math.cos(d) * Math.sin(east), Math.cos(d0) * Math.sin(d) - Math.sin(d0) * Math.cos(d) * Math.cos(east)];
    let [x, y] = near > 0 ? [0, 0] : [NaN, NaN];
    for (let k = 0; k < 50; k += 1) {
      const own = this.tangent(x, y), [e, n] = [goal[0] / near - own[0], goal[1] / near - own[1]];
      [x, y] = [x + (e * re + n * im) / (re * re + im * im), y + (n * re - e * im) / (re * re + im * im)];
    }
    return [x, y];
  }

  // Arrows toward north and east. The position angle of +y is measured from north toward east.
  compass() {
    const angle = this.data.position_angle;
    if (angle === null) return null;
    const [s, c] = [Math.sin(angle * Math.PI / 180), Math.cos(angle * Math.PI / 180)];
    return { N: [-this.stage.flip * s, c], E: [this.stage.flip * c, s] }; // (right, up) on the screen
  }
}

function diamond(context, x, y, size) {
  context.moveTo(x, y - size);
  context.lineTo(x + size, y);
  context.lineTo(x, y + size);
  context.lineTo(x - size, y);
  context.closePath();
}
