// A surface that can be turned: software z-buffer on a 2-D canvas, so that it looks the same everywhere and needs
// neither a GPU nor a network. Each <figure class="viewer"> names a JSON block:
// {nx, ny, x, y, z: base64 float32 rows of mm, NaN where unknown, exaggeration, label,
//  layers: [{name, unit, low, high, data: base64 float32, lut: base64 of 256 RGB triples}]}
"use strict";

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const floats = (text) => new Float32Array(bytes(text).buffer);
const clamp = (v, low, high) => Math.min(high, Math.max(low, v));

// Colours of a table of 256 from left to right; digits behind the point at the ends of a colour scale.
function gradient(lut) {
  const stops = [...Array(17).keys()].map((i) => `rgb(${lut.subarray(3 * Math.min(255, 16 * i)).slice(0, 3)})`);
  return `linear-gradient(to right, ${stops})`;
}
const endDigits = ({ low, high }) => clamp(2 - Math.floor(Math.log10(Math.max(Math.abs(low), Math.abs(high)) || 1)), 0, 12);

function niceTicks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= raw);
  const ticks = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-9; v += step) ticks.push(v);
  return { ticks, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

class SurfaceViewer {
  constructor(figure) {
    this.figure = figure;
    this.canvas = figure.querySelector("canvas");
    const model = JSON.parse(document.getElementById(figure.dataset.surface).textContent);
    Object.assign(this, model);
    for (const name of ["x", "y", "z"]) this[name] = floats(model[name]);
    this.layers = model.layers.map((l) => ({ ...l, data: floats(l.data), lut: bytes(l.lut) }));
    this.layer = this.layers[0];
    const ends = (values) => {
      const finite = values.filter(Number.isFinite);
      return [finite.reduce((a, b) => Math.min(a, b), Infinity), finite.reduce((a, b) => Math.max(a, b), -Infinity)];
    };
    const [x, y, z] = [this.x, this.y, this.z].map(ends);
    [this.x0, this.width] = [x[0], x[1] - x[0]];
    [this.y0, this.depth] = [y[0], y[1] - y[0]];
    [this.low, this.high] = z;
    this.reset();
    this.listen();
    this.fillLegend();
    this.draw();
  }

  reset() {
    this.yaw = -0.6;
    this.pitch = 0.6;
    this.zoom = 1;
    this.factor = 1;
  }

  listen() {
    const canvas = this.canvas;
    const pointers = new Map();
    const spread = () => {
      const [a, b] = [...pointers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const before = pointers.size === 2 ? spread() : 0;
      const now = { x: event.clientX, y: event.clientY };
      pointers.set(event.pointerId, now);
      if (pointers.size === 2) {
        this.zoom = clamp((this.zoom * spread()) / before, 0.3, 8);
      } else {
        this.yaw -= (now.x - last.x) * 0.008;
        this.pitch = clamp(this.pitch + (now.y - last.y) * 0.008, 0.05, Math.PI / 2);
      }
      this.redraw();
    });
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls until it is clicked
        event.preventDefault();
        this.zoom = clamp(this.zoom * Math.exp(-event.deltaY * 0.001), 0.3, 8);
        this.redraw();
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (!turn) return;
      event.preventDefault();
      this.yaw += turn[0];
      this.pitch = clamp(this.pitch + turn[1], 0.05, Math.PI / 2);
      this.redraw();
    });
    const slider = this.figure.querySelector("input[type=range]");
    slider.addEventListener("input", () => {
      this.factor = 2 ** Number(slider.value);
      this.redraw();
    });
    const select = this.figure.querySelector("select");
    select.addEventListener("change", () => {
      this.layer = this.layers[select.selectedIndex];
      this.fillLegend();
      this.redraw();
    });
    const back = () => {
      this.reset();
      slider.value = 0;
      this.redraw();
    };
    canvas.addEventListener("dblclick", back);
    this.figure.querySelector("button").addEventListener("click", back);
    new ResizeObserver(() => this.redraw()).observe(canvas);
    recoloured(() => this.draw());
  }

  redraw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.draw();
    });
  }

  fillLegend() {
    const { lut, low, high, unit, below, above } = this.layer;
    this.figure.querySelector(".bar").style.background = gradient(lut);
    const digits = endDigits(this.layer);
    const text = (v) => (Number(v.toFixed(digits)) || 0).toString().replace("-", "\u2212");
    this.figure.querySelector(".low").textContent = (below ? "\u2264 " : "") + text(low);
    this.figure.querySelector(".high").textContent = `${above ? "\u2265 " : ""}${text(high)} ${unit}`;
  }

  // Screen position of a model point (mm) and its nearness; the camera is at infinity.
  project(x, y, z) {
    const s = this.scale;
    const X = x - this.x0 - this.width / 2;
    const Y = y - this.y0 - this.depth / 2;
    const Z = (z - this.low) * this.lift - this.midLift;
    const away = -X * this.sinYaw + Y * this.cosYaw;
    return [
      this.pixels[0] / 2 + s * (X * this.cosYaw + Y * this.sinYaw),
      this.pixels[1] / 2 - s * (Z * this.cosPitch + away * this.sinPitch),
      Z * this.sinPitch - away * this.cosPitch,
    ];
  }

  prepare() {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const w = Math.max(64, Math.round(this.canvas.clientWidth * ratio));
    const h = Math.max(64, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== w || this.canvas.height !== h) {
      this.canvas.width = w;
      this.canvas.height = h;
    }
    this.ratio = ratio;
    this.pixels = [w, h];
    this.lift = this.exaggeration * this.factor;
    this.midLift = ((this.high - this.low) * this.lift) / 4; // a peak weighs less than its base
    this.sinYaw = Math.sin(this.yaw);
    this.cosYaw = Math.cos(this.yaw);
    this.sinPitch = Math.sin(this.pitch);
    this.cosPitch = Math.cos(this.pitch);
    // as large as it goes in at the first view, whatever the turn; margins hold the ticks
    const diagonal = Math.hypot(this.width, this.depth);
    const tall = diagonal * Math.sin(0.6) + (this.high - this.low) * this.exaggeration * Math.cos(0.6);
    this.scale = this.zoom * Math.min((w - 120 * ratio) / diagonal, (0.94 * h) / tall);
  }

  draw() {
    this.prepare();
    const [w, h] = this.pixels;
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, w, h);
    const style = getComputedStyle(this.canvas);
    context.strokeStyle = context.fillStyle = style.color;
    context.lineWidth = this.ratio;
    this.drawBase(context);
    const layer = new ImageData(w, h);
    this.rasterise(layer.data, w, h);
    const scratch = document.createElement("canvas");
    scratch.width = w;
    scratch.height = h;
    scratch.getContext("2d").putImageData(layer, 0, 0);
    context.drawImage(scratch, 0, 0);
    this.drawAxes(context);
  }

  // Screen coordinates, nearness and shade of every vertex, then two triangles per cell.
  rasterise(out, w, h) {
    const { nx, ny, x, y, z } = this;
    const count = nx * ny;
    const sx = new Float32Array(count), sy = new Float32Array(count), near = new Float32Array(count);
    const shade = new Float32Array(count), value = new Float32Array(count);
    const { data, low, high } = this.layer;
    for (let j = 0, k = 0; j < ny; j++)
      for (let i = 0; i < nx; i++, k++) {
        const p = this.project(x[k], y[k], z[k]);
        sx[k] = p[0];
        sy[k] = p[1];
        near[k] = p[2];
        value[k] = clamp(((data[k] - low) / (high - low || 1)) * 255, 0, 255);
        shade[k] = this.light(i, j, k);
      }
    const buffer = new Float32Array(w * h).fill(-Infinity);
    const target = { out, w, h, buffer, sx, sy, near, shade, value, lut: this.layer.lut };
    for (let j = 0; j + 1 < ny; j++)
      for (let i = 0; i + 1 < nx; i++) {
        const k = j * nx + i;
        fillTriangle(target, k, k + 1, k + nx);
        fillTriangle(target, k + 1, k + nx + 1, k + nx);
      }
  }

  light(i, j, k) {
    const { nx, ny, x, y, z, lift } = this;
    const step = (a, b) => [x[b] - x[a], y[b] - y[a], (z[b] - z[a]) * lift];
    const [ax, ay, az] = step(i ? k - 1 : k, i + 1 < nx ? k + 1 : k);
    const [bx, by, bz] = step(j ? k - nx : k, j + 1 < ny ? k + nx : k);
    const area = ax * by - ay * bx;
    const slope = (v) => (Number.isFinite(v) ? v : 0);
    const gx = slope((az * by - bz * ay) / area), gy = slope((ax * bz - bx * az) / area);
    const n = Math.sqrt(1 + gx * gx + gy * gy);
    // the light comes over the viewer's left shoulder and turns with the view
    const lx = -0.55 * this.cosYaw + 0.35 * this.sinYaw, ly = -0.55 * this.sinYaw - 0.35 * this.cosYaw;
    return clamp(0.42 + 0.68 * Math.max(0, (-gx * lx - gy * ly + 0.76) / n), 0, 1.1);
  }

  drawBase(context) {
    const { x0, y0, width, depth, low } = this;
    const corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(([a, b]) => this.project(x0 + a * width, y0 + b * depth, low));
    context.globalAlpha = 0.5;
    context.beginPath();
    corners.forEach((p, i) => (i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
    context.closePath();
    context.stroke();
    context.globalAlpha = 1;
  }

  // The two base edges nearest to the viewer with ticks in mm, and the height at the leftmost corner.
  drawAxes(context) {
    const { x0, y0, width, depth, low, high } = this;
    const size = 12 * this.ratio;
    context.font = `${size}px system-ui, sans-serif`;
    context.textBaseline = "middle";
    const nearY = this.cosYaw > 0 ? y0 : y0 + depth;
    const nearX = this.sinYaw > 0 ? x0 + width : x0;
    const line = (a, b) => {
      context.beginPath();
      context.moveTo(a[0], a[1]);
      context.lineTo(b[0], b[1]);
      context.stroke();
    };
    const axis = (name, from, to, at, outward) => {
      line(at(from), at(to));
      const { ticks, digits } = niceTicks(from, to, 4);
      const middle = at((from + to) / 2), beyond = outward((from + to) / 2);
      const away = [beyond[0] - middle[0], beyond[1] - middle[1]];
      const norm = Math.hypot(...away) || 1;
      const put = (p, text, distance) => {
        const x = p[0] + (away[0] / norm) * distance, y = p[1] + (away[1] / norm) * distance;
        context.textAlign = away[0] > 0.3 * norm ? "left" : away[0] < -0.3 * norm ? "right" : "center";
        context.fillText(text, x, y);
      };
      for (const t of ticks) {
        const p = at(t);
        line(p, [p[0] + (away[0] / norm) * 5 * this.ratio, p[1] + (away[1] / norm) * 5 * this.ratio]);
        put(p, t.toFixed(digits).replace("-", "\u2212"), 8 * this.ratio + size / 2);
      }
      put(middle, name, 8 * this.ratio + 2.6 * size);
    };
    const outX = nearX === x0 ? x0 - width : x0 + 2 * width, outY = nearY === y0 ? y0 - depth : y0 + 2 * depth;
    axis("x [mm]", x0, x0 + width, (t) => this.project(t, nearY, low), (t) => this.project(t, outY, low));
    axis("y [mm]", y0, y0 + depth, (t) => this.project(nearX, t, low), (t) => this.project(outX, t, low));
    if (!(high > low) || this.cosPitch < 0.15) return;
    const corners = [0, 1].flatMap((a) => [0, 1].map((b) => [x0 + a * width, y0 + b * depth]));
    const left = corners.reduce((a, b) => (this.project(...a, low)[0] < this.project(...b, low)[0] ? a : b));
    const foot = this.project(...left, low), top = this.project(...left, high);
    line(foot, top);
    context.textAlign = "right";
    const [factor, unit] = high - low >= 0.1 ? [1, "mm"] : high - low >= 1e-4 ? [1e3, "\u00b5m"] : [1e6, "nm"];
    const count = Math.max(2, Math.min(4, Math.floor((foot[1] - top[1]) / (2 * size))));
    const { ticks, digits } = niceTicks(factor * low, factor * high, count);
    for (const t of ticks) {
      const p = this.project(...left, t / factor);
      line(p, [p[0] - 5 * this.ratio, p[1]]);
      context.fillText(t.toFixed(digits).replace("-", "\u2212"), p[0] - 8 * this.ratio, p[1]);
    }
    context.textAlign = "center";
    context.fillText(`${this.label} [${unit}]`, top[0], top[1] - 1.2 * size);
  }
}

function fillTriangle(t, a, b, c) {
  const { sx, sy, near, shade, value, w, h, buffer, out, lut } = t;
  const ax = sx[a], ay = sy[a], bx = sx[b], by = sy[b], cx = sx[c], cy = sy[c];
  const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
  if (!(Math.abs(area) > 1e-9)) return; // also where a corner has no height
  const x0 = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), x1 = Math.min(w - 1, Math.floor(Math.max(ax, bx, cx) + 0.5));
  const y0 = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), y1 = Math.min(h - 1, Math.floor(Math.max(ay, by, cy) + 0.5));
  for (let y = y0; y <= y1; y++)
    for (let x = x0; x <= x1; x++) {
      const p = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area;
      const q = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area;
      const r = 1 - p - q;
      if (p < -1e-4 || q < -1e-4 || r < -1e-4) continue;
      const nearness = p * near[a] + q * near[b] + r * near[c];
      const k = y * w + x;
      if (nearness <= buffer[k]) continue;
      buffer[k] = nearness;
      const light = p * shade[a] + q * shade[b] + r * shade[c];
      const m = Math.round(p * value[a] + q * value[b] + r * value[c]) * 3;
      out[4 * k] = lut[m] * light;
      out[4 * k + 1] = lut[m + 1] * light;
      out[4 * k + 2] = lut[m + 2] * light;
      out[4 * k + 3] = 255;
    }
}

const page = document.documentElement;
try {
  document.querySelectorAll("figure.viewer").forEach((figure) => new SurfaceViewer(figure));
  page.dataset.viewer = "ready";
} catch (error) {
  page.dataset.viewer = `failed: ${error.message}`;
  throw error;
}
