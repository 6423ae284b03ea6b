"use strict";
const $ = id => document.getElementById(id), share = v => `${(100 * v).toFixed(v > 0 && v < 0.001 ? 3 : v < 0.1 ? 1 : 0)} %`;
const token = document.querySelector("meta[name=token]").content;
let form = 0, typing = 0, drawing = 0;

function made(tag, text, kind) {
  const one = document.createElement(tag);
  if (text) one.textContent = text;
  if (kind) one.className = kind;
  return one;
}

async function post(answer) {
  for (const each of document.querySelectorAll("#form button, nav button")) each.disabled = true;
  await fetch("/answer", { method: "POST", headers: { "X-Optolever-Token": token }, body: JSON.stringify(answer) });
}

function button(text, answer, kind, art) {
  const one = made("button", "", kind), picture = art && $(art);
  one.type = "button";
  if (picture) one.append(picture.content.cloneNode(true));
  one.append(text);
  one.onclick = () => post({ id: form, ...answer });
  return one;
}

function answers() {
  return Object.fromEntries([...document.querySelectorAll("#form input")].map(one => [one.name, one.value]));
}

/** The sketches of the display and of the view by the answers. */
function sketch() {
  const { display, view_distance, view_width } = answers(), [cols, rows] = (display ?? "").split("x").map(Number);
  if ($("screen") && cols > 0 && rows > 0) {
    const scale = Math.min(136 / cols, 78 / rows), [w, h] = [cols * scale, rows * scale], [x, y] = [108 - w / 2, 51 - h / 2];
    for (const [name, value] of Object.entries({ x, y, width: w, height: h })) $("screen").setAttribute(name, value);
    $("diagonal").setAttribute("d", `M${x} ${y + h}L${x + w} ${y}`);
  }
  if ($("cone")) {
    const ratio = view_width / view_distance, half = Math.min(50, 78 * (ratio > 0 ? ratio : 2 * Math.tan(Math.PI / 6)));
    $("cone").setAttribute("d", `M24 55L180 ${55 - half}M24 55L180 ${55 + half}`);
    $("width").setAttribute("d", `M192 ${55 - half}V${55 + half}`);
  }
}

async function draw() {
  sketch();
  const mine = ++drawing, found = await fetch(`/drawing?${new URLSearchParams(answers())}`);
  if (mine !== drawing) return;
  if (found.status === 204) return;
  $("drawing").hidden = false;
  if (!found.ok) { $("drawn-says").textContent = await found.text(); $("drawn-says").className = "error"; return; }
  $("drawn-says").textContent = "The rig from the side, by these numbers."; $("drawn-says").className = "";
  const bitmap = await createImageBitmap(await found.blob());
  $("drawn").width = bitmap.width; $("drawn").height = bitmap.height;
  $("drawn").getContext("2d").drawImage(bitmap, 0, 0);
}

function ask(f) {
  for (const each of f.fields) {
    const label = made("label", each.text), input = made("input");
    input.name = each.name; input.value = each.value; input.autocomplete = "off";
    input.oninput = () => { clearTimeout(typing); typing = setTimeout(draw, 300); };
    label.append(input, made("span", each.error || `A wrong answer: ${each.wrong}.`, each.error ? "error" : "wrong"));
    $("form").append(label);
  }
  const next = made("button", "Go on", "first");
  $("form").append(next);
  $("form").onsubmit = event => { event.preventDefault(); post({ id: form, fields: answers() }); };
  document.querySelector("#form input")?.focus();
  draw();
}

function build(f, step, rig) {
  $("form").replaceChildren(); $("drawing").hidden = true; $("form").onsubmit = event => event.preventDefault();
  $("look").hidden = !f || f.kind !== "look";
  if (!f) return;
  const art = $(`art-${f.fields?.[0].name}`) ?? $(`art-${step}`) ?? $(`art-${step}-${rig}`);
  if (art) $("form").append(art.content.cloneNode(true));
  if (f.kind === "ask") ask(f);
  if (f.kind === "pick") {
    const options = made("div", "", "options");
    f.options.forEach((text, k) => options.append(button(text, { number: k }, k === f.default ? "first" : "", `art-${step}-${k}`)));
    $("form").append(made("p", f.text), options);
  }
  if (f.kind === "go") {
    $("form").append(made("p", f.text), ...f.keys.map(([key, word], k) => button(word[0].toUpperCase() + word.slice(1), { key }, k ? "" : "first")));
  }
  if (f.kind === "look") $("form").append(button("It is aimed and sharp: go on", {}, "first"));
}

async function look(now, count) {
  $("advice").textContent = now.advice; $("advice").className = now.good ? "good" : "";
  $("sharpness").textContent = share(now.sharpness); $("bar").value = now.sharpness;
  $("sees").textContent = share(now.sees_share); $("saturated").textContent = share(now.saturated_share);
  const next = new Image();
  next.src = `/picture?${count}`;
  try { await next.decode(); $("picture").src = next.src; } catch { /* the next one comes */ }
}

async function loop() {
  let count = -1, silent = 0;
  for (;;) {
    let now;
    try { now = await (await fetch(`/state?after=${count}`)).json(); }
    catch { $("title").textContent = `The program has ended: start ${document.title} again, it goes on here.`; build(null); return; }
    if (now.count === count) {
      if (++silent > 2 && now.form?.kind === "look" && now.aim) { $("advice").textContent = "No new picture: is the camera connected?"; $("advice").className = ""; }
      continue;
    }
    count = now.count; silent = 0;
    if (now.live) { location.href = now.live; return; }
    const at = now.steps.findIndex(([name]) => name === now.step);
    $("steps").replaceChildren(...now.steps.map(([name, title], k) => {
      const one = made("button", title);
      one.disabled = k >= at; if (k === at) one.setAttribute("aria-current", "step");
      one.onclick = () => post({ go: name });
      return one;
    }));
    $("title").textContent = at < 0 ? "" : now.steps[at][1];
    $("lines").replaceChildren(...now.lines.map(([text, fault]) => made("p", text, fault ? "fault" : "")));
    $("busy").hidden = !now.busy; $("busy").textContent = now.busy;
    if ((now.form?.id ?? 0) !== form) { form = now.form?.id ?? 0; build(now.form, now.step, now.rig); }
    if (now.form?.kind === "look" && now.aim) await look(now.aim, count);
  }
}
loop();
