"use strict";
const $ = id => document.getElementById(id), share = v => `${(100 * v).toFixed(v > 0 && v < 0.001 ? 3 : v < 0.1 ? 1 : 0)} %`;
async function loop() {
  let count = 0;
  for (;;) {
    let now;
    try { now = await (await fetch(`/next?after=${count}`)).json(); }
    catch { $("advice").textContent = "The program has ended: start optolever camera preview again."; $("advice").className = ""; return; }
    if (now.count === count) { if (count) { $("advice").textContent = "No new picture: is the camera connected?"; $("advice").className = ""; } continue; }
    count = now.count;
    $("advice").textContent = now.advice; $("advice").className = now.good ? "good" : "";
    $("sharpness").textContent = share(now.sharpness); $("bar").value = now.sharpness;
    $("sees").textContent = share(now.sees_share); $("saturated").textContent = share(now.saturated_share);
    const next = new Image();
    next.src = `/picture?${count}`;
    try { await next.decode(); $("picture").src = next.src; } catch { /* the next one comes */ }
  }
}
loop();
