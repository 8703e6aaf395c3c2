// The drawing of a map of tiles: the projections, the graticule with its labels, and the fields.

const RAD = Math.PI / 180;
// The colors of plot_tiling: the color map viridis of Matplotlib without its darkest third, on paper and on all screens.
const VIRIDIS = [[47, 108, 142], [38, 130, 142], [31, 153, 138], [40, 174, 128], [78, 195, 107], [132, 212, 75], [194, 223, 35], [253, 231, 37]];
const STEPS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30]; // degrees between the lines of the graticule

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

// The inverse of a projection: right ascension and declination, or null outside of the map.
function inverse(whole, ra0, dec0) {
  const [sin0, cos0] = [Math.sin(dec0 * RAD), Math.cos(dec0 * RAD)];
  return (x, y) => {
    const [a, b] = [x * RAD, y * RAD];
    const square = whole ? (a / 4) ** 2 + (b / 2) ** 2 : (a * a + b * b) / 4;
    if (square > (whole ? 0.5 : 1)) return null;
    const z = Math.sqrt(1 - square);
    const [east, sin] = whole ? [2 * Math.atan2(z * a / 2, 2 * z * z - 1), z * b] :
      [Math.atan2(z * a, cos0 * (1 - 2 * square) - z * b * sin0), (1 - 2 * square) * sin0 + z * b * cos0];
    return [(ra0 + east / RAD + 360) % 360, Math.asin(Math.max(-1, Math.min(1, sin))) / RAD];
  };
}

class SkyMapDrawing {
  binColor(bin) {
    const part = this.words.length > 1 ? bin / (this.words.length - 1) : 0.5;
    const at = (VIRIDIS.length - 1) * part;
    const k = Math.min(Math.floor(at), VIRIDIS.length - 2);
    return `rgb(${VIRIDIS[k].map((v, i) => Math.round(v + (VIRIDIS[k + 1][i] - v) * (at - k))).join(" ")})`;
  }

  // The lines of right ascension and declination in the visible part of the map, as [text, points].
  graticule(stage) {
    const [ra0] = this.data.center;
    const seen = [];
    for (let i = 0; i <= 8; i += 1) for (let j = 0; j <= 8; j += 1) seen.push(this.unproject(...stage.toWorld(stage.width * i / 8, stage.height * j / 8)));
    const inside = (ra, dec) => {
      const [px, py] = stage.toScreen(...this.project(ra, dec));
      return px >= 0 && py >= 0 && px <= stage.width && py <= stage.height;
    };
    const poles = [-90, 90].filter((dec) => inside(ra0, dec));
    const wide = seen.includes(null) || (poles.length > 0 && !this.data.whole);
    const east = (ra) => ((ra - ra0) % 360 + 540) % 360 - 180;
    const range = (values, least, most) => {
      const [low, high] = [Math.min(...values), Math.max(...values)];
      const more = (high - low) / 8;
      return [Math.max(low - more, least), Math.min(high + more, most)];
    };
    const known = seen.filter(Boolean);
    const [d0, d1] = wide && this.data.whole ? [-90, 90] : range([...known.map(([, dec]) => dec), ...poles], -90, 90);
    const [e0, e1] = wide ? [-179.999, 179.999] : range(known.map(([ra]) => east(ra)), -179.999, 179.999);
    const nearest = d0 > 0 ? d0 : d1 < 0 ? d1 : 0; // the declination at which lines of right ascension are farthest apart
    const stepOf = (size, pixels) => STEPS.find((step) => step * size >= pixels) ?? 30;
    const [stepE, stepD] = [stepOf(stage.scale * Math.cos(nearest * RAD), 80), stepOf(stage.scale, 60)];
    const along = (from, to, f) => Array.from({ length: 61 }, (_, k) => stage.toScreen(...this.project(...f(from + (to - from) * k / 60))));
    const decimals = (step) => (step < 0.1 ? 2 : step < 1 ? 1 : 0);
    const lines = [];
    for (let k = Math.ceil((ra0 + e0) / stepE); k * stepE <= ra0 + e1; k += 1) {
      lines.push([`${fixed((k * stepE + 360) % 360, decimals(stepE))}\u00b0`, true, along(d0, d1, (dec) => [k * stepE, dec])]);
    }
    for (let k = Math.ceil(d0 / stepD); k * stepD <= d1; k += 1) {
      const text = `${k > 0 ? "+" : ""}${fixed(k * stepD, decimals(stepD))}\u00b0`;
      lines.push([text, false, along(ra0 + e0, ra0 + e1, (ra) => [ra, k * stepD])]);
    }
    if (wide && this.data.whole) for (const side of [e0, e1]) lines.push(["", true, along(-90, 90, (dec) => [ra0 + side, dec])]);
    return lines;
  }

  // Labels of right ascension are at the top or, on the whole sky, at the equator; labels of declination are on the left.
  paintLabels(context, stage, lines) {
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.fillStyle = stage.color("soft");
    const equator = stage.toScreen(...this.project(this.data.center[0], 0))[1];
    for (const [text, upward, points] of lines) {
      const visible = points.filter(([px, py]) => px > 2 && px < stage.width - 60 && py > 8 && py < stage.height - 8);
      if (!text || !visible.length) continue;
      const goal = upward ? ([, py]) => (this.data.whole ? Math.abs(py - equator) : py) : ([px]) => px;
      const [px, py] = visible.reduce((best, point) => (goal(point) < goal(best) ? point : best));
      if (!upward && py > stage.height - 90 && px < 90) continue; // the compass is there
      context.textAlign = upward ? "center" : "left";
      const aligned = !this.data.whole && (upward ? py : px) < 50;
      if (upward) label(context, stage, text, Math.max(px, 20), aligned ? 12 : py + 6);
      else label(context, stage, text, aligned ? 4 : px + 2, py);
    }
  }

  // Lines toward north and east at the center of the plot.
  compass() {
    const [ra, dec] = this.unproject(this.stage.x, this.stage.y) ?? this.data.center;
    const step = dec > 89.9 ? -0.01 : 0.01;
    const [x, y] = this.project(ra, dec);
    const [nx, ny] = this.project(ra, dec + step);
    const long = Math.hypot(nx - x, ny - y) * Math.sign(step);
    const north = [-(nx - x) / long, (ny - y) / long];
    return { N: north, E: [-north[1], north[0]] };
  }

  paint(context, stage) {
    const lines = this.graticule(stage);
    context.strokeStyle = stage.color("faint");
    context.lineWidth = 1;
    context.beginPath();
    for (const [, , points] of lines) points.forEach((point, k) => (k ? context.lineTo(...point) : context.moveTo(...point)));
    context.stroke();
    const bins = [...this.words, null].map(() => []);
    const r = this.data.radius * stage.scale;
    const margin = Math.min(r, 200);
    for (let k = 0; k < this.n; k += 1) {
      if (!this.shown(k)) continue;
      const [px, py] = stage.toScreen(this.x[k], this.y[k]);
      if (px > -margin && py > -margin && px < stage.width + margin && py < stage.height + margin) bins.at(this.bin[k]).push(k);
    }
    // Without a GPU, hundreds of overlapping fields take longer to draw than a frame lasts.
    this.large = r > (bins.flat().length > 400 ? 24 : 12);
    const missing = bins.pop();
    for (const paint of this.large ? ["paintFields", "paintDisks"] : ["paintSquares"]) {
      bins.forEach((rows, bin) => {
        context.fillStyle = context.strokeStyle = this.binColor(bin);
        context.beginPath();
        this[paint](context, stage, rows, r);
      });
    }
    this.paintMissing(context, stage, missing, r);
    this.paintLabels(context, stage, lines);
    paintCompass(context, stage, this.compass());
    if (!this.data.whole) paintScale(context, stage, "\u00b0");
    if (this.selected >= 0) this.paintRim(context, stage, this.selected, 3);
  }

  paintRim(context, stage, k, width) {
    context.strokeStyle = stage.color("c-mark");
    context.lineWidth = width;
    context.beginPath();
    this.pathOf(context, stage, k);
    context.stroke();
  }

  paintHovered(context, stage, k) { this.paintRim(context, stage, k, 1.5); }

  // Large fields are translucent, with an opaque disk at the center, whose color does not depend on other fields.
  paintFields(context, stage, rows) {
    for (const k of rows) this.pathOf(context, stage, k);
    context.globalAlpha = 0.2;
    context.fill();
    context.globalAlpha = 1;
    context.lineWidth = 2;
    context.stroke();
  }

  paintDisks(context, stage, rows, r) {
    for (const k of rows) {
      const [px, py] = stage.toScreen(this.x[k], this.y[k]);
      context.moveTo(px + r * 0.22, py);
      context.arc(px, py, r * 0.22, 0, 2 * Math.PI);
    }
    context.fill();
  }

  paintSquares(context, stage, rows, r, hollow = false) {
    const size = Math.max(1, r * 0.45);
    for (const k of rows) {
      const [px, py] = stage.toScreen(this.x[k], this.y[k]);
      context.rect(px - size, py - size, 2 * size, 2 * size);
    }
    if (!hollow) context.fill();
  }

  paintMissing(context, stage, rows, r) {
    context.strokeStyle = stage.color("c-idle");
    context.lineWidth = r > 12 ? 1.5 : 1;
    context.beginPath();
    context.setLineDash(r > 12 ? [5, 4] : []);
    if (this.large) for (const k of rows) this.pathOf(context, stage, k);
    else this.paintSquares(context, stage, rows, r, true);
    context.stroke();
    context.setLineDash([]);
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
}
