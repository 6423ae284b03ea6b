// The page of `optolever live`: asks for a reading, draws it, asks for the next. Charts by uPlot.
"use strict";
const SPAN = 20, FONT = "12px system-ui, sans-serif";  // s of the traces
const INKS = [  // as many as contacts at most
  "#e4572e", "#1f9ed8", "#2e9e5b", "#b565d9", "#c99700", "#7f8c9a", "#d62779", "#00a3a3",
  "#8c564b", "#5b6ee1", "#8a9a00", "#f08a8a", "#7a3fa0", "#3f7f93", "#b08a5a", "#7ccd32",
];
const $ = (id) => document.getElementById(id);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const past = [], slots = new Map();  // readings of the last SPAN s; contact -> its colour
let count = 0, paused = false, answered = "", answeredAt = 0, fresh = performance.now(), now = 0, first = null;
let reason = "", box = null, last = null;  // why the camera is gone; where the map lies; the last numbers

const show = (v, d = 3) => (v === null || v === undefined || !Number.isFinite(v) ? "–" : Number(v.toPrecision(d)).toString());
const nothing = (v) => v === null || v === undefined;
function both(value, sigma) {  // two digits of sigma
  if (nothing(value)) return "–";
  if (!(sigma > 0)) return show(value, 4);
  const digits = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(sigma))));
  return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)}`;
}
function element(tag, text, parent) {
  const made = document.createElement(tag);
  made.textContent = text;
  if (parent) parent.append(made);
  return made;
}
function colour(t) {  // dark blue over teal to yellow
  t = Math.max(0, Math.min(1, t));
  return [255 * Math.min(1, Math.max(0, 1.8 * t - 0.6)), 40 + 200 * t, 120 + 90 * Math.sin(3.1 * t) - 90 * t];
}
function ticks(low, high, most = 5) {  // about five round numbers
  const raw = (high - low) / most, ten = 10 ** Math.floor(Math.log10(raw)), all = [];
  const step = [1, 2, 5, 10].map((k) => k * ten).find((k) => k >= raw);
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) all.push(k * step);
  return all;
}

// A contact keeps its colour as long as it is seen; a new one takes the first that is free.
function slot(identity) {
  if (!slots.has(identity)) {
    const taken = new Set(slots.values());
    let k = 0;
    while (taken.has(k)) k++;
    slots.set(identity, k % INKS.length);
  }
  return slots.get(identity);
}

// Series of INKS over x, twice as many where each has a dashed companion.
class Chart {
  constructor(id, across, label, more = {}) {
    Object.assign(this, { holder: $(id), log: false, least: 1, kinds: 1, x: [0, SPAN], y: [0, 1], ends: [], ...more });
    if (this.log) this.y = [0.1, 10];
    const axis = (text, extra) => ({
      label: text, font: FONT, labelFont: FONT, labelSize: 18, stroke: () => css("--dim"),
      grid: { stroke: () => css("--line"), width: 1 }, ticks: { stroke: () => css("--line"), width: 1 }, ...extra,
    });
    const series = [{}];
    for (let k = 0; k < this.kinds * INKS.length; k++)
      series.push({ stroke: INKS[k % INKS.length], width: 1.5, dash: k < INKS.length ? [] : [4, 3], points: { show: false } });
    this.size = () => ({ width: Math.max(200, this.holder.clientWidth), height: 190 });
    this.plot = new uPlot({
      ...this.size(), series, legend: { show: false }, cursor: { drag: { x: false, y: false } },
      scales: { x: { time: false, range: () => this.x }, y: { distr: this.log ? 3 : 1, range: () => this.y } },
      axes: [axis(across, { size: 32 }), axis(label, { size: 58, values: (u, all) => all.map((v) => (v === null ? "" : show(v, 4))) })],
      hooks: { draw: [(u) => this.bands(u)] },
    }, [[0, 1], ...series.slice(1).map(() => [null, null])], this.holder);
    new ResizeObserver(() => this.holder.clientWidth && this.plot.setSize(this.size())).observe(this.holder);
  }

  draw(x, columns, ends = []) {  // ends: [value, sigma] of the last reading by series
    const known = columns.flat().filter((v) => !nothing(v) && (!this.log || v > 0));
    let [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : this.log ? [0.1, 10] : [0, this.least];
    const pad = Math.max(0.08 * (high - low), (this.least - high + low) / 2, 0);
    this.y = this.log ? [low / 2, 2 * high] : [low - pad, high + pad];
    this.ends = ends;
    this.plot.setData([x, ...columns]);
  }

  bands(u) {  // one sigma on either side of the last value
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.globalAlpha = 0.2;
    this.ends.forEach((end, k) => {
      if (!end || nothing(end[0]) || !(end[1] > 0)) return;
      const top = u.valToPos(end[0] + end[1], "y", true), bottom = u.valToPos(end[0] - end[1], "y", true);
      ctx.fillStyle = INKS[k % INKS.length];
      ctx.fillRect(bbox.left, top, bbox.width, bottom - top);
    });
    ctx.restore();
  }
}

// pick(reading) -> [series, value, sigma] of each
function overTime(chart, pick) {
  const total = chart.kinds * INKS.length, x = [], columns = Array.from({ length: total }, () => []);
  let ends = [];
  past.forEach((reading, k) => {
    if (k && reading.t - past[k - 1].t > 1) { x.push(past[k - 1].t + 0.5); columns.forEach((one) => one.push(null)); }
    x.push(reading.t);
    columns.forEach((one) => one.push(null));
    ends = [];
    for (const [at, value, sigma] of pick(reading)) { columns[at][x.length - 1] = value; ends[at] = [value, sigma]; }
  });
  chart.x = [Math.max(0, now - SPAN), Math.max(now, SPAN)];
  chart.draw(x, columns, ends);
}

// x to the right, y upwards, as in the report: rows from the largest y, columns from the least x.
function oriented(n, values) {
  const out = new Float32Array(values.length), flip = turns(n);
  for (let i = 0; i < n.rows; i++) for (let j = 0; j < n.cols; j++)
    out[i * n.cols + j] = values[(flip[0] ? n.rows - 1 - i : i) * n.cols + (flip[1] ? n.cols - 1 - j : j)];
  return out;
}
const turns = (n) => [n.y[0] < n.y[1], n.x[0] > n.x[1]];
const turned = (n, [row, col]) => { const [r, c] = turns(n); return [r ? 1 - row : row, c ? 1 - col : col]; };

function canvas(id, ratio) {  // cleared, in CSS pixels
  const one = $(id), W = Math.max(200, one.clientWidth), H = Math.round(ratio * W), dense = devicePixelRatio || 1;
  if (one.width !== Math.round(W * dense) || one.height !== Math.round(H * dense)) { one.width = W * dense; one.height = H * dense; }
  const g = one.getContext("2d");
  g.setTransform(dense, 0, 0, dense, 0, 0);
  g.clearRect(0, 0, W, H);
  return { g, W, H };
}

// share(value) in 0..1, NaN: none; bar: [share, text] of the scale. Returns the box of the map.
function drawField(id, n, values, share, bar) {
  const wide = n.cols / n.rows, room = 96, { g, W, H } = canvas(id, Math.min(1, 0.86 / wide + 0.06));
  const image = new ImageData(n.cols, n.rows), small = new OffscreenCanvas(n.cols, n.rows);
  for (let i = 0; i < values.length; i++) {
    const t = share(values[i]);
    image.data.set([...(Number.isNaN(t) ? [125, 125, 125] : colour(t)), 255], 4 * i);
  }
  small.getContext("2d").putImageData(image, 0, 0);
  const scale = Math.min((W - room) / n.cols, (H - 28) / n.rows), w = n.cols * scale, h = n.rows * scale, x = 30, y = 6;
  g.imageSmoothingEnabled = false;
  g.drawImage(small, x, y, w, h);
  g.fillStyle = css("--dim"); g.font = FONT; g.textAlign = "center"; g.textBaseline = "top";
  const [left, right] = [Math.min(...n.x), Math.max(...n.x)], [low, high] = [Math.min(...n.y), Math.max(...n.y)];
  for (const v of ticks(left, right)) g.fillText(show(v), x + (v - left) / (right - left) * w, y + h + 5);
  g.textAlign = "right"; g.textBaseline = "middle";
  for (const v of ticks(low, high)) g.fillText(show(v), x - 4, y + (high - v) / (high - low) * h);
  for (let k = 0; k < h; k++) { g.fillStyle = `rgb(${colour(1 - k / h).map(Math.round)})`; g.fillRect(x + w + 10, y + k, 10, 1.5); }
  g.fillStyle = css("--dim"); g.textAlign = "left";
  for (const [t, text] of bar) g.fillText(text, x + w + 24, y + (1 - t) * (h - 1));
  return { g, x, y, w, h };
}
function drawMap(n, z, top) {
  box = drawField("map", n, z, (v) => v / top, ticks(0, top).map((v) => [v / top, show(v)]));
  const { g, x, y, w, h } = box;
  const mark = (at, text, ink, cross) => {
    const [row, col] = turned(n, at), px = x + col * w, py = y + row * h;
    g.strokeStyle = g.fillStyle = ink; g.lineWidth = 2; g.font = FONT; g.textAlign = "left"; g.textBaseline = "middle"; g.beginPath();
    if (cross) { g.moveTo(px - 6, py); g.lineTo(px + 6, py); g.moveTo(px, py - 6); g.lineTo(px, py + 6); } else g.arc(px, py, 7, 0, 7);
    g.stroke(); g.fillStyle = "#000a"; g.fillRect(px + 7, py - 17, g.measureText(text).width + 6, 16); g.fillStyle = ink; g.fillText(text, px + 10, py - 8);
  };
  n.touches.forEach((t, k) => mark(n.marks[k], String(t.identity), INKS[slot(t.identity)], false));
  n.places.forEach((at, k) => mark(at, `P${k + 1}`, INKS[k % INKS.length], true));
}
function drawSigma(n, sigma) {  // two decades from that of the median
  const low = 10 ** Math.floor(Math.log10(n.sigma_um || 1));
  drawField("sigma", n, sigma, (v) => Math.log10(v / low) / 2, [1, 3, 10, 30, 100].map((k) => [Math.log10(k) / 2, show(k * low)]));
}
function drawSurface(z, rows, cols, top) {  // strips between rows as vertical lines, from the back to the front
  const { g, W, H } = canvas("surface", 0.72), image = new ImageData(W, H);
  const ink = new Uint32Array(image.data.buffer), before = new Float32Array(W).fill(NaN);
  for (let i = 0; i < rows; i++) for (let x = 0; x < W; x++) {
    const v = i / rows - 0.5, u = (x / W - 0.5 - 0.25 * v) / 0.66, j = Math.floor((u + 0.5) * cols);
    if (j < 0 || j + 1 >= cols) { before[x] = NaN; continue; }
    const left = z[i * cols + j] / top, slope = z[i * cols + j + 1] / top - left;
    const h = left + slope * ((u + 0.5) * cols - j), bad = Number.isNaN(h);
    const y = H * (0.62 + 0.4 * v - 0.12 * u - 0.42 * (bad ? 0 : Math.max(-0.3, Math.min(h, 1.2)))), light = 0.9 + 4 * slope;
    const [r, green, b] = bad ? [125, 125, 125] : colour(h).map((c) => Math.max(0, Math.min(255, c * light)));
    const pixel = 0xff000000 | b << 16 | green << 8 | r, end = Math.min(H - 1, Math.max(y, before[x]));
    for (let k = Math.max(0, Math.round(Math.min(y, before[x]))); k <= end; k++) ink[k * W + x] = pixel;
    before[x] = y;
  }
  const small = new OffscreenCanvas(W, H);
  small.getContext("2d").putImageData(image, 0, 0);
  g.drawImage(small, 0, 0);
}
async function picture(one, bytes) {
  const image = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
  one.width = image.width; one.height = image.height;
  one.getContext("bitmaprenderer").transferFromImageBitmap(image);
}

function drawSpectra(spectra) {
  const longest = spectra.reduce((one, s) => (s && (!one || s.nm.length > one.nm.length) ? s : one), null);
  if (!longest) { charts.spectrum.x = [0, 30]; charts.spectrum.draw([0, 1], INKS.map(() => [null, null])); return; }
  const x = longest.nm.map((_, i) => i * longest.step_hz);
  const columns = INKS.map((_, k) => x.map((hz, i) => {
    const s = spectra[k], at = s ? Math.round(hz / s.step_hz) : 0;
    return s && i && s.nm[at] > 0 ? s.nm[at] : null;
  }));
  charts.spectrum.x = [0, longest.rate_hz / 2];
  charts.spectrum.draw(x, columns);
}
function names(id, all) {  // [text, colour]
  $(id).replaceChildren(...all.map(([text, ink]) => { const one = element("b", text); one.style.color = ink; return one; }));
}
function rows(id, all) {
  $(id).replaceChildren(...all.map((cells) => {
    const row = document.createElement("tr");
    for (const cell of cells) element("td", "", row).append(cell);
    return row;
  }));
}
const noForce = (n) => (!n.layer ? "the scene names no [layer]" : !n.trusted ? "not trusted" : n.touches.length ? "" : "nothing touches");
// The height of a probe as it is chosen: raw, less the picture's shift, or less the first probe; mm.
function traced(all, k) {
  const p = all[k], kind = $("kind").value;
  if (kind === "steady") return p.steady;
  if (kind === "raw" || p.z === null) return p.z;
  return k && all[0].z !== null ? p.z - all[0].z : null;
}
function scattered(all, k) {
  return $("kind").value === "difference" ? Math.hypot(all[k].sigma, all[0].sigma) : all[k].sigma;
}
function radius(t) {
  return nothing(t.indenter_radius) ? "–" : both(t.indenter_radius, t.indenter_radius_sigma);
}

function cards(n) {
  const newtons = n.forces.reduce((sum, f) => sum + f.newton, 0), sigma = Math.hypot(...n.forces.map((f) => f.sigma));
  $("depth").textContent = nothing(n.depth_mm) ? "–" : `${both(1e3 * n.depth_mm, 1e3 * n.depth_sigma_mm)} µm`;
  $("depth-says").textContent = nothing(n.depth_mm) ? "none beyond five sigma" : `± ${show(1e3 * n.depth_total_sigma_mm, 2)} with the rig's numbers, ${n.touches.length} contact${n.touches.length === 1 ? "" : "s"}, range used ${Math.round(100 * n.range_used)} %`;
  $("newton").textContent = n.forces.length ? `${both(newtons, sigma)} N` : "–";
  $("newton-says").textContent = n.forces.length ? (n.forces.length > 1 ? "sum of all contacts" : "") : noForce(n);
  $("rate").textContent = `${show(n.rate)} /s`;
  $("rate-says").textContent = `readings/s; ${n.skipped} frames skipped`;
  $("delay").textContent = `${show(1e3 * n.delay_s)} ms`;
  $("trusted").textContent = n.trusted ? "yes" : "no";
  $("trusted").className = n.trusted ? "value" : "value bad";
  $("trusted-says").textContent = n.trusted ? `sigma ${show(n.sigma_um)} µm, lost ${show(100 * n.lost, 2)} %` : n.reason;
}
function tables(n) {
  const force = Object.fromEntries(n.forces.map((f) => [f.identity, f]));
  rows("touches", n.touches.map((t) => {
    const f = force[t.identity], about = t.hole ? "≈ " : "", least = t.depth_at_least ? "≥ " : about;
    return [t.identity, `${show(t.x, 4)}, ${show(t.y, 4)}`, least + both(1e3 * t.depth, 1e3 * t.depth_sigma),
      `${t.force_at_least ? "≥ " : ""}${both(t.area, t.area_sigma)}`, radius(t), f ? about + both(f.newton, f.sigma) : noForce(n) || "–"].map(String);
  }));
  if ($("probes").contains(document.activeElement)) return;  // a button that is about to be pressed stays
  rows("probes", n.probes.map((p, k) => {
    const s = n.spectra[k], cell = document.createElement("span"), remove = element("button", "Remove");
    remove.onclick = () => command(`clear?probe=${k + 1}`);
    element("span", s ? `${s.text} ` : $("kind").value === "difference" && !k ? "" : "a few frames more ", cell);
    cell.append(remove);
    return [`P${k + 1}`, `${show(p.x, 4)}, ${show(p.y, 4)}`, nothing(traced(n.probes, k)) ? "–" : both(1e3 * traced(n.probes, k), 1e3 * scattered(n.probes, k)), cell];
  }));
}

async function draw(body) {
  const view = new DataView(body), lengths = [0, 1, 2, 3].map((k) => view.getUint32(4 * k, true)), parts = [];
  let at = 16;
  for (const length of lengths) { parts.push(body.slice(at, at + length)); at += length; }
  const n = JSON.parse(new TextDecoder().decode(parts[0]));
  if (n.error) { reason = n.error; say(reason, true); }
  if (n.count > count) fresh = performance.now() - 1e3 * n.age_s;
  if (n.count === count || paused) return;
  count = n.count; last = n;
  const z = oriented(n, new Float32Array(parts[3])), sigma = oriented(n, new Float32Array(parts[2]));
  let top = Number($("scale").value);
  if (!(top > 0)) { top = Math.max(1e-3, 20 * n.sigma_um); for (const value of z) if (value > top) top = value; }  // noise alone stays dark
  if (first === null || n.time_s < first) { first = n.time_s; past.length = 0; }
  now = n.time_s - first;
  past.push({ t: now, probes: n.probes, touches: n.touches, forces: n.forces });
  while (past[0].t < now - SPAN) past.shift();
  const seen = new Set(past.flatMap((one) => one.touches.map((t) => t.identity)));
  for (const identity of [...slots.keys()]) if (!seen.has(identity)) slots.delete(identity);
  cards(n);
  drawMap(n, z, top); drawSigma(n, sigma); drawSurface(z, n.rows, n.cols, top); drawSpectra(n.spectra);
  overTime(charts.trace, (one) => one.probes.map((p, k) => {
    const z = traced(one.probes, k);
    return [k, nothing(z) ? null : 1e3 * z, 1e3 * scattered(one.probes, k)];
  }));
  overTime(charts.deep, (one) => one.touches.map((t) => [slot(t.identity), 1e3 * t.depth, 1e3 * t.depth_sigma]));
  overTime(charts.place, (one) => one.touches.flatMap((t) => [[slot(t.identity), t.x], [slot(t.identity) + INKS.length, t.y]]));
  $("forces").hidden = !past.some((one) => one.forces.length);
  if (!$("forces").hidden) overTime(charts.force, (one) => one.forces.map((f) => [slot(f.identity), f.newton, f.sigma]));
  names("contact-names", [...seen].map((identity) => [String(identity), INKS[slot(identity)]]));
  names("probe-names", n.probes.map((_, k) => [`P${k + 1}`, INKS[k % INKS.length]]));
  tables(n);
  $("record").textContent = n.recording ? "Stop recording" : "Record"; $("record").title = n.recording;
  if (n.answer !== answered) { answered = n.answer; answeredAt = now; }  // an answer to a command stays ten seconds
  say([n.error || now < answeredAt + 10 ? answered : "", n.trusted ? "" : `not trusted: ${n.reason}`, ...n.notices].filter(Boolean).join(" · "), !n.trusted || n.error);
  await picture($("camera"), parts[1]);
}
function say(text, bad) {
  $("state").textContent = text;
  $("state").className = bad ? "bad" : "";
}
const gone = () => say(reason ? `${reason} · the program has ended` : "the program is gone", true);

async function loop() {
  let drawn = null;  // the picture of a reading is decoded while the next one is fetched
  for (;;) {
    try {
      if (paused) await new Promise((done) => setTimeout(done, 1000));  // it still notices the program's end
      const answer = await fetch(`/next?after=${count}&trace=${$("kind").value}`);
      const body = await answer.arrayBuffer();
      await drawn;
      if (answer.status === 200) drawn = draw(body);
      if (answer.status === 503) { reason = new TextDecoder().decode(body); say(reason, true); }
    } catch (error) {
      if (!(error instanceof TypeError)) console.error(error);
      gone();
      await new Promise((done) => setTimeout(done, 500));
    }
  }
}
setInterval(() => {
  const age = (performance.now() - fresh) / 1e3;
  $("age").textContent = paused ? "paused: this page only" : age > 1 ? `the picture is ${age.toFixed(1)} s old` : "";
}, 200);
const headers = { "X-Optolever-Token": document.querySelector("meta[name=token]").content };
const command = async (name) => {
  try { say(await (await fetch(`/${name}`, { method: "POST", headers })).text(), false); }
  catch (error) { gone(); }
};
function probe(row, col) {  // shares of the map as it is drawn
  const at = turned(last, [row, col]).map((v) => Math.min(0.999999, Math.max(0, v)).toFixed(6));
  command(`probe?at=${at}`);
}
$("pause").onclick = () => { paused = !paused; $("pause").textContent = paused ? "Go on" : "Pause"; $("pause").ariaPressed = paused; };
for (const name of ["tare", "record", "clear"]) $(name).onclick = () => command(name);
$("map").onclick = (event) => {
  if (!box) return;
  const row = (event.offsetY - box.y) / box.h, col = (event.offsetX - box.x) / box.w;
  if (row >= 0 && row < 1 && col >= 0 && col < 1) probe(row, col);
};
$("add").onsubmit = (event) => {
  event.preventDefault();
  if (!last) return;
  const [left, right] = [Math.min(...last.x), Math.max(...last.x)], [low, high] = [Math.min(...last.y), Math.max(...last.y)];
  const col = (Number($("probe-x").value) - left) / (right - left), row = (high - Number($("probe-y").value)) / (high - low);
  if (row >= 0 && row <= 1 && col >= 0 && col <= 1) probe(row, col);
  else say(`a probe must be at x ${show(left)} to ${show(right)}, y ${show(low)} to ${show(high)} mm`, true);
};
const charts = {
  deep: new Chart("deep", "time, s", "µm", { least: 0.1 }),
  force: new Chart("force", "time, s", "N", { least: 0.01 }),
  place: new Chart("place", "time, s", "mm", { kinds: 2 }),
  trace: new Chart("trace", "time, s", "µm", { least: 0.01 }),
  spectrum: new Chart("spectrum", "frequency, Hz", "nm", { log: true }),
};
loop();
