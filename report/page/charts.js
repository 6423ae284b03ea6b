// Maps and charts of a measurement, drawn by uPlot (axes, zoom, cursor). JSON blocks of the page:
// map-data: name -> {x0, y0, dx, dy, nx, ny, x, y, down, cols, pixel: base64 int32 (cols 0: no pixel's), luts: base64 of RGB,
//   layers: [{name, unit, low, high, digits, colours, sigma, true, data: base64 float32, categories}]}
// chart-data: id -> {title, x, series: [{name, kind, values}], axes, log, names, range}
"use strict";

const read = (id) => JSON.parse(document.getElementById(id).textContent);
// Draws again in other colours: paper is light.
function recoloured(draw) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  for (const [event, print] of [["beforeprint", true], ["afterprint", false]])
    addEventListener(event, () => {
      document.documentElement.classList.toggle("print", print);
      draw();
    });
}
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const FONT = "12px system-ui, sans-serif";
const WHEEL = ["--accent", "--bad", "--good"];
const plots = [];

function number(value, digits) {
  if (!Number.isFinite(value)) return "\u2013";
  return Number(value.toPrecision(Math.max(1, digits))).toString().replaceAll("-", "\u2212");
}

function axis(label, more = {}) {
  const line = () => colour("--line");
  return {
    label, stroke: () => colour("--soft"), font: FONT, labelFont: FONT, labelSize: 20,
    grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1 },
    size: (u, values) => 22 + 7.2 * Math.max(3, ...(values || []).map((v) => (v === null ? 0 : String(v).length))),
    ...more,
  };
}

const across = (label, more = {}) => axis(label, { size: 32, ...(label ? {} : { labelSize: 0 }), ...more });

// Keep a plot at the size that its figure's width allows.
function follow(figure, plot, size) {
  plots.push(plot);
  const fit = () => {
    if (!figure.clientWidth) return;
    const now = size(figure.clientWidth);
    if (now.width !== plot.width || now.height !== plot.height) plot.setSize(now);
  };
  new ResizeObserver(() => requestAnimationFrame(fit)).observe(figure);
}

function element(parent, tag, className, text = "") {
  const made = document.createElement(tag);
  made.className = className;
  made.textContent = text;
  parent.append(made);
  return made;
}

// Place of a value on a layer's colour scale, 0 to 1; and the value there.
function share({ low, high, log }, value) {
  return log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low || 1);
}
const valueAt = ({ low, high, log }, at) => (log ? low * (high / low) ** at : low + at * (high - low));

// A text for who does not see the picture.
function describe(plot, text) {
  const canvas = plot.root.querySelector("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", text);
}

class MapPlot {
  constructor(figure, model) {
    Object.assign(this, { figure, model });
    this.head = element(figure, "p", "map-head");
    this.name = element(this.head, "strong", "");
    this.legend = element(this.head, "span", "legend");
    const holder = element(figure, "div", "plot");
    this.readout = element(figure, "p", "readout");
    this.lines = [];
    const { x0, y0, dx, dy, nx, ny } = model;
    this.ends = [x0, x0 + nx * dx, y0, y0 + ny * dy];
    const plain = (u, low, high) => [low, high];
    const size = (room) => { // one scale for both axes
      const scale = Math.min((room - 90) / (nx * dx), 584 / (ny * dy));
      return { width: Math.round(90 + scale * nx * dx), height: Math.round(56 + scale * ny * dy) };
    };
    this.plot = new uPlot(
      {
        ...size(figure.clientWidth || 600), legend: { show: false },
        scales: { x: { time: false, range: plain }, y: { range: plain, dir: model.down ? -1 : 1 } },
        series: [{}, { paths: () => null, points: { show: false } }],
        axes: [across(model.x, { grid: { show: false } }), axis(model.y, { grid: { show: false } })],
        cursor: {
          drag: { x: true, y: true, uni: 20 },
          bind: { mousedown: (u, target, handler) => (event) => (this.press(event) ? null : handler(event)) },
        },
        hooks: { drawAxes: [() => this.drawImage()], draw: [() => this.drawLines()], setCursor: [(u) => this.read(u)] },
      },
      [this.ends.slice(0, 2), this.ends.slice(2)],
      holder,
    );
    follow(figure, this.plot, size);
    this.show(figure.dataset.layer);
  }

  show(name) {
    const { nx, ny, luts, down } = this.model;
    const layer = (this.layer = this.model.layers.find((each) => each.name === name));
    layer.values ||= floats(layer.data);
    const picture = new ImageData(nx, ny);
    const lut = layer.categories ? null : bytes(luts[layer.colours]);
    const swatches = (layer.categories || []).map(([, hex]) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)));
    for (let row = 0; row < ny; row++)
      for (let col = 0; col < nx; col++) {
        const value = layer.values[row * nx + col];
        if (Number.isNaN(value)) continue;
        const at = 4 * ((down ? row : ny - 1 - row) * nx + col);
        const k = 3 * Math.round(255 * clamp(share(layer, value), 0, 1));
        picture.data.set([...(lut ? lut.subarray(k, k + 3) : swatches[value]), 255], at);
      }
    this.image = document.createElement("canvas");
    Object.assign(this.image, { width: nx, height: ny });
    this.image.getContext("2d").putImageData(picture, 0, 0);
    this.name.textContent = name + (layer.unit ? ` [${layer.unit}]` : "");
    this.legend.replaceChildren();
    for (const [word, hex] of layer.categories || []) {
      element(this.legend, "span", "swatch").style.background = hex;
      element(this.legend, "span", "", word);
    }
    if (lut) {
      const digits = endDigits(layer);
      const end = (value) => number(Number(value.toFixed(digits)) || 0, 3);
      const scale = element(this.legend, "span", "scale");
      element(scale, "span", "bar").style.background = gradient(lut);
      const ticks = element(scale, "span", "ticks");
      for (const at of [0, 0.5, 1]) element(ticks, "span", "", (at === 0 && layer.below ? "\u2264 " : at === 1 && layer.above ? "\u2265 " : "") + end(valueAt(layer, at)));
    }
    const range = layer.categories ? "" : ` from ${number(layer.low, 3)} to ${number(layer.high, 3)} ${layer.unit}`;
    describe(this.plot, `map of ${name}${range} over ${this.model.x} and ${this.model.y}`);
    this.plot.redraw(false);
    this.read(this.plot);
  }

  drawImage() {
    const { ctx, bbox } = this.plot;
    const [left, right, low, high] = this.ends;
    const x = [left, right].map((v) => this.plot.valToPos(v, "x", true));
    const y = [low, high].map((v) => this.plot.valToPos(v, "y", true)).sort((a, b) => a - b);
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.imageSmoothingEnabled = false;
    if (this.image) ctx.drawImage(this.image, x[0], y[0], x[1] - x[0], y[1] - y[0]);
    ctx.restore();
  }

  drawLines() {
    const { ctx, bbox } = this.plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const [a, b] of this.lines)
      for (const [style, width] of [["rgba(255, 255, 255, .5)", 3], ["#111", 1]]) {
        ctx.strokeStyle = style;
        ctx.lineWidth = width * devicePixelRatio;
        ctx.beginPath();
        for (const p of [a, b]) ctx.lineTo(this.plot.valToPos(p[0], "x", true), this.plot.valToPos(p[1], "y", true));
        ctx.stroke();
      }
    ctx.restore();
  }

  at(event) {
    const box = this.plot.over.getBoundingClientRect();
    return [this.plot.posToVal(event.clientX - box.left, "x"), this.plot.posToVal(event.clientY - box.top, "y")];
  }

  // Pointer down: true where the drag draws a line in place of a zoom. A click without a drag picks a point.
  press(event) {
    if (!this.picked) return false;
    const start = this.at(event);
    const drawing = document.getElementById("draw-line").checked;
    const up = (end) => {
      removeEventListener("mouseup", up);
      const moved = Math.hypot(end.clientX - event.clientX, end.clientY - event.clientY) > 4;
      if (!moved) this.picked(start);
      else if (drawing) this.picked(null, [start, this.at(end)]);
    };
    addEventListener("mouseup", up);
    return drawing;
  }

  cell(x, y) {
    const { x0, y0, dx, dy, nx, ny } = this.model;
    const col = Math.floor((x - x0) / dx), row = Math.floor((y - y0) / dy);
    return col >= 0 && row >= 0 && col < nx && row < ny ? row * nx + col : -1;
  }

  value(layer, cell) {
    layer.values ||= floats(layer.data);
    return cell < 0 ? NaN : layer.values[cell];
  }

  // Every layer of the map at the pointer, and the camera pixel that they are of.
  read(u) {
    const inside = u.cursor.left >= 0;
    const cell = inside ? this.cell(u.posToVal(u.cursor.left, "x"), u.posToVal(u.cursor.top, "y")) : -1;
    this.pixels ||= new Int32Array(bytes(this.model.pixel).buffer);
    const pixel = cell < 0 ? -1 : this.pixels[cell];
    if (pixel < 0) {
      this.readout.textContent = inside ? "no sample here" : "\u00a0";
      return;
    }
    const { cols } = this.model;
    const all = this.picked ? this.model.layers : [this.layer];
    const texts = all.map((layer) => {
      const value = this.value(layer, cell);
      if (layer.categories) return layer.categories[value][0];
      return `${layer.name} ${number(value, layer.digits)} ${layer.unit}`;
    });
    const place = [u.posToVal(u.cursor.left, "x"), u.posToVal(u.cursor.top, "y")].map((v) => number(v, 5));
    const of = cols ? `, camera pixel row ${Math.floor(pixel / cols)}, column ${pixel % cols}` : "";
    this.readout.textContent = `(${place})${of}: ${texts.join("; ")}`;
  }
}

function chart(figure, spec) {
  const kinds = {
    line: { width: 1.6 },
    points: { paths: () => null, points: { show: true, size: 6 } },
    bars: { paths: uPlot.paths.bars({ size: [0.8, 60] }), width: 0, points: { show: false } },
    edge: { width: 0 },
    truth: { width: 4 },
  };
  const grey = ({ kind }) => kind === "edge" || kind === "truth";
  const coloured = spec.series.filter((each) => !grey(each));
  const series = spec.series.map((each) => {
    const { name, kind } = each;
    const stroke = () => colour(grey(each) ? "--soft" : WHEEL[coloured.indexOf(each) % WHEEL.length]);
    const fill = kind === "bars" || kind === "points" ? { fill: stroke } : {};
    const made = { label: name, stroke, ...fill, ...kinds[kind], value: (u, v) => number(v ?? NaN, 6) };
    if (kind === "points") made.points = { ...made.points, stroke, fill: stroke };
    else made.points = { show: false };
    return made;
  });
  const scale = { time: false, ...(spec.log ? { distr: 3 } : {}), ...(spec.range ? { range: () => spec.range } : {}) };
  const x = across(spec.axes[0], spec.names ? { rotate: -90, size: 62, grid: { show: false } } : {});
  if (spec.names) {
    x.splits = () => spec.x;
    x.values = () => spec.names;
  }
  const ticks = spec.log ? { values: (u, splits) => splits.map((v) => (v === null ? null : number(v, 2))) } : {};
  const size = (width) => ({ width, height: spec.names ? 300 : spec.strip ? 84 : spec.plain ? 160 : 240 });
  const first = { value: (u, v) => (spec.names ? spec.names[v] : number(v ?? NaN, 5)), label: spec.names ? "term" : spec.axes[0] };
  const margin = spec.names ? { range: (u, low, high) => [low - 0.7, high + 0.7] } : {};
  const plot = new uPlot(
    {
      title: spec.title, legend: { show: !spec.plain, live: false }, ...size(figure.clientWidth || 300),
      scales: { x: { ...scale, ...margin }, y: { ...scale, time: undefined, ...(spec.ends ? { range: () => spec.ends } : {}) } },
      series: [first, ...series], bands: spec.bands || [],
      axes: [{ ...x, ...(spec.log ? ticks : {}) }, axis(spec.axes[1], { ...ticks, ...(spec.marks ? { splits: () => spec.marks } : {}) })],
    },
    [spec.x, ...spec.series.map((each) => each.values)],
    figure,
  );
  follow(figure, plot, size);
  describe(plot, `chart of ${spec.series.map(({ name }) => name).join(", ")} over ${spec.axes[0]}${spec.title ? `: ${spec.title}` : ""}`);
  return plot;
}

// Profiles of the map's layer along x and y through a point, and along the line that the reader draws.
class Profiles {
  constructor(map) {
    this.map = map;
    const [left, right, low, high] = map.ends;
    this.point = [(left + right) / 2, (low + high) / 2];
    this.line = [[left, low], [right, high]];
    map.picked = (point, line) => {
      if (point) this.point = point;
      if (line) this.line = line;
      this.update();
    };
    this.update();
  }

  update() {
    const [left, right, low, high] = this.map.ends;
    const [x, y] = this.point;
    const lines = { x: [[left, y], [right, y]], y: [[x, low], [x, high]], line: this.line };
    this.map.lines = Object.values(lines);
    this.map.plot.redraw(false);
    for (const [name, ends] of Object.entries(lines)) this.draw(name, ends);
  }

  draw(name, [a, b]) {
    const { map } = this, { model, layer } = map;
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    const count = Math.max(2, Math.round(length / Math.min(model.dx, model.dy)));
    const others = [layer.sigma, layer.true].map((key) => model.layers.find((each) => each.name === key));
    const [sigma, truth] = others;
    const columns = { at: [], cells: [], value: [], low: [], high: [], truth: [] };
    const known = (value) => (Number.isFinite(value) ? value : null);
    for (let k = 0; k < count; k++) {
      const t = (k + 0.5) / count;
      const cell = map.cell(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]));
      const value = map.value(layer, cell);
      columns.at.push(name === "x" ? a[0] + t * length : name === "y" ? a[1] + t * length : t * length);
      columns.cells.push(cell);
      columns.value.push(known(value));
      if (sigma) {
        const wide = 2 * map.value(sigma, cell) * inUnit(sigma.unit, layer.unit);
        columns.low.push(known(value - wide));
        columns.high.push(known(value + wide));
      }
      if (truth) columns.truth.push(known(map.value(truth, cell) * inUnit(truth.unit, layer.unit)));
    }
    const series = [], bands = [];
    if (sigma) {
      series.push({ name: "+ 2 sigma", kind: "edge", values: columns.high }, { name: "\u2212 2 sigma", kind: "edge", values: columns.low });
      bands.push({ series: [1, 2], fill: () => colour("--band") });
    }
    if (truth) series.push({ name: layer.true, kind: "truth", values: columns.truth });
    series.push({ name: layer.name, kind: "line", values: columns.value });
    const through = name === "x" ? `y = ${number(a[1], 5)} mm` : name === "y" ? `x = ${number(a[0], 5)} mm` : "along the line";
    const axes = [name === "line" ? "distance [mm]" : `${name} [mm]`, `${layer.name} [${layer.unit}]`];
    const figure = document.getElementById(`profile-${name}`);
    figure.replaceChildren();
    chart(figure, { title: through, x: columns.at, series, axes, bands, plain: true });
    const strip = model.layers.find((each) => each.name === layer.strip);
    if (strip) this.strip(figure, columns, strip);
  }

  // Error or deviation along the profile in nm; the band is +- 2 sigma about 0, of an error by noise.
  strip(figure, { at, cells }, layer) {
    const { model } = this.map;
    const known = (value) => (Number.isFinite(value) ? value : null);
    const residual = cells.map((cell) => known(inUnit(layer.unit, "nm") * this.map.value(layer, cell)));
    const named = (wanted) => model.layers.find(({ name }) => name === wanted);
    const noise = (layer.name === "error" && named("sigma by noise")) || named(layer.sigma);
    const series = [], bands = [];
    const wide = cells.map((cell) => (noise ? 2 * inUnit(noise.unit, "nm") * this.map.value(noise, cell) : NaN));
    if (noise) {
      for (const sign of [1, -1])
        series.push({ name: `2 ${noise.name}`, kind: "edge", values: wide.map((one) => known(sign * one)) });
      bands.push({ series: [1, 2], fill: () => colour("--band") });
    }
    series.push({ name: layer.name, kind: "line", values: residual });
    const sizes = [...residual, ...wide].filter(Number.isFinite).map(Math.abs).sort((a, b) => a - b);
    const most = sizes[Math.floor(0.98 * sizes.length)] || 1; // what lies beyond is cut off
    const ends = [-1.3 * most, 1.3 * most], mark = Number(most.toPrecision(1));
    chart(figure, { x: at, series, axes: ["", "[nm]"], bands, plain: true, strip: true, ends, marks: [-mark, 0, mark] });
  }
}

const SIZES = { mm: 1, "\u00b5m": 1e-3, nm: 1e-6 };
const inUnit = (from, to) => (from in SIZES && to in SIZES ? SIZES[from] / SIZES[to] : 1);

function drawAll() {
  const models = read("map-data"), charts = document.getElementById("chart-data") ? read("chart-data") : {};
  const maps = [...document.querySelectorAll("figure.map")].map((figure) => new MapPlot(figure, models[figure.dataset.map]));
  const select = document.getElementById("layer");
  if (select) {
    const [main] = maps;
    const profiles = new Profiles(main);
    select.addEventListener("change", () => {
      main.show(select.value);
      profiles.update();
    });
  }
  for (const [id, spec] of Object.entries(charts)) chart(document.getElementById(id), spec);
  recoloured(() => plots.forEach((plot) => plot.redraw(false)));
  page.dataset.charts = "ready";
}

if (document.getElementById("map-data")) drawAll();
