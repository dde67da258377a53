"use strict";
const by = (id) => document.getElementById(id),
  D = JSON.parse(by("data").textContent),
  F = D.t.length,
  N = D.names.length;
// a robot that is not in the team is drawn nowhere
D.q = D.q.map((frame) => frame.map((at) => at || []));
const slider = by("time");
slider.max = F - 1;
function fit(c, ratio) {
  const r = window.devicePixelRatio || 1,
    w = c.clientWidth || 300;
  c.width = w * r;
  c.height = w * ratio * r;
  c.style.height = w * ratio + "px";
  const g = c.getContext("2d");
  g.setTransform(r, 0, 0, r, 0, 0);
  g.clearRect(0, 0, w, w * ratio);
  g.font = "11px system-ui,sans-serif";
  return [g, w, w * ratio];
}
function step(span) {
  const raw = span / 5,
    p = Math.pow(10, Math.floor(Math.log10(raw)));
  return [1, 2, 5, 10].map((k) => k * p).find((k) => k >= raw);
}
function dot(g, x, y, r, fill, line) {
  g.beginPath();
  g.arc(x, y, r, 0, 7);
  if (fill) {
    g.fillStyle = fill;
    g.fill();
  }
  if (line) {
    g.strokeStyle = line;
    g.lineWidth = 2;
    g.stroke();
  }
}
function scene(id, a, b, f) {
  const [g, w, h] = fit(by(id), 1),
    m = 26,
    s = (w - m - 6) / D.span,
    X = (v) => m + (v - D.low[a]) * s,
    Y = (v) => h - m - (v - D.low[b]) * s;
  g.strokeStyle = "#eee";
  g.fillStyle = "#666";
  const d = step(D.span);
  for (let i = 0; i < 2; i++) {
    const c = i ? b : a;
    for (let v = Math.ceil(D.low[c] / d) * d; v <= D.low[c] + D.span; v += d) {
      g.beginPath();
      if (i) {
        g.moveTo(m, Y(v));
        g.lineTo(w - 6, Y(v));
        g.fillText(+v.toFixed(6), 2, Y(v) + 4);
      } else {
        g.moveTo(X(v), 6);
        g.lineTo(X(v), h - m);
        g.fillText(+v.toFixed(6), X(v) - 6, h - m + 14);
      }
      g.stroke();
    }
  }
  const P = (i) => D.q[f][i],
    lead = D.lead[f];
  g.strokeStyle = "rgba(0,114,178,.18)";
  g.lineWidth = 1;
  for (let i = 0; i < N; i++) {
    g.beginPath();
    for (let k = Math.max(0, f - 150); k <= f; k++) g.lineTo(X(D.q[k][i][a]), Y(D.q[k][i][b]));
    g.stroke();
  }
  g.strokeStyle = "#aaa";
  for (const [i, j] of D.links.filter((l) => l[0] <= D.t[f]).pop()[1]) {
    g.beginPath();
    g.moveTo(X(P(i)[a]), Y(P(i)[b]));
    g.lineTo(X(P(j)[a]), Y(P(j)[b]));
    g.stroke();
  }
  dot(g, X(D.goal[a]), Y(D.goal[b]), 10, null, "#009e73");
  dot(g, X(D.goal[a]), Y(D.goal[b]), 2, "#009e73");
  for (let i = 0; i < N; i++) if (i !== lead) dot(g, X(P(i)[a]), Y(P(i)[b]), 5, "#0072b2", "#fff");
  dot(g, X(P(lead)[a]), Y(P(lead)[b]), 7, "#d55e00", "#fff");
}
function arrow(g, x, y, u, v) {
  const l = Math.hypot(u, v);
  g.strokeStyle = g.fillStyle = "#d55e00";
  g.lineWidth = 3;
  g.beginPath();
  g.moveTo(x, y);
  g.lineTo(x + u, y + v);
  g.stroke();
  if (l > 3) {
    const c = u / l,
      s = v / l,
      k = Math.min(9, l);
    g.beginPath();
    g.moveTo(x + u + c * 2, y + v + s * 2);
    g.lineTo(x + u - k * c - k * 0.5 * s, y + v - k * s + k * 0.5 * c);
    g.lineTo(x + u - k * c + k * 0.5 * s, y + v - k * s - k * 0.5 * c);
    g.fill();
  }
}
function felt(f) {
  const [g, w, h] = fit(by("force"), 1.0),
    c = (w - 40) / 2 + 6,
    r = c - 14,
    F3 = D.f[f];
  g.strokeStyle = "#ddd";
  for (const part of [0.5, 1]) {
    g.beginPath();
    g.arc(c, h / 2, r * part, 0, 7);
    g.stroke();
    g.fillStyle = "#666";
    g.fillText((D.most * part).toPrecision(2), c + 4, h / 2 - r * part - 3);
  }
  arrow(g, c, h / 2, (r * F3[0]) / D.most, (-r * F3[1]) / D.most);
  g.fillStyle = "#666";
  g.fillText("x, y", c - 10, h - 4);
  const zx = w - 18;
  g.strokeStyle = "#ddd";
  g.beginPath();
  g.moveTo(zx, h / 2 - r);
  g.lineTo(zx, h / 2 + r);
  g.stroke();
  arrow(g, zx, h / 2, 0, (-r * F3[2]) / D.most);
  g.fillStyle = "#666";
  g.fillText("z", zx - 3, h - 4);
}
function course(f) {
  const c = by("far"),
    [g, w, h] = fit(c, 0.18),
    m = 44,
    lo = Math.log10(D.tolerance) - 1,
    hi = Math.log10(Math.max(...D.far)) + 0.1,
    X = (k) => m + ((w - m - 6) * D.t[k]) / D.t[F - 1],
    Y = (v) => 6 + ((h - 30) * (hi - Math.max(Math.log10(v), lo))) / (hi - lo);
  g.fillStyle = "#666";
  for (let e = Math.ceil(lo); e <= hi; e++) {
    g.fillText("1e" + e, 8, Y(Math.pow(10, e)) + 4);
    g.strokeStyle = "#eee";
    g.beginPath();
    g.moveTo(m, Y(Math.pow(10, e)));
    g.lineTo(w - 6, Y(Math.pow(10, e)));
    g.stroke();
  }
  g.strokeStyle = "#0072b2";
  g.lineWidth = 1.5;
  g.beginPath();
  for (let k = 0; k < F; k++) g.lineTo(X(k), Y(D.far[k]));
  g.stroke();
  g.strokeStyle = "#d55e00";
  g.lineWidth = 1;
  for (let k = 1; k < F; k++)
    if (D.lead[k] !== D.lead[k - 1]) {
      g.beginPath();
      g.moveTo(X(k), h - 22);
      g.lineTo(X(k), h - 14);
      g.stroke();
    }
  g.fillText("switches of the leader", m, h - 3);
  g.strokeStyle = "#222";
  g.beginPath();
  g.moveTo(X(f), 4);
  g.lineTo(X(f), h - 22);
  g.stroke();
}
function draw() {
  const f = Math.min(Math.floor(now), F - 1);
  slider.value = f;
  by("clock").textContent = D.t[f].toFixed(1) + " s";
  scene("top", 0, 1, f);
  scene("side", 0, 2, f);
  felt(f);
  course(f);
  by("told").textContent =
    "leader: " +
    D.names[D.lead[f]] +
    "  ·  greatest distance to the goal: " +
    (D.far[f] < 0.01 ? D.far[f].toExponential(1) : D.far[f].toFixed(2)) +
    " m";
}
let now = 0,
  running = true,
  last = null;
const quiet = matchMedia("(prefers-reduced-motion: reduce)").matches;
function pause(p) {
  running = !p;
  by("play").textContent = running ? "Pause" : "Play";
  last = null;
  if (running) {
    if (now >= F - 1) now = 0;
    requestAnimationFrame(tick);
  }
}
function tick(s) {
  if (!running) return;
  if (last !== null) now += (((s - last) / 1000) * (+by("speed").value || 1)) / D.step;
  last = s;
  if (now >= F - 1) {
    now = F - 1;
    pause(true);
  }
  draw();
  if (running) requestAnimationFrame(tick);
}
by("play").onclick = () => pause(running);
slider.oninput = () => {
  pause(true);
  now = +slider.value;
  draw();
};
window.onresize = draw;
const place = /^#t=([0-9.]+)$/.exec(location.hash);
if (place) {
  now = Math.min(+place[1] / D.step, F - 1);
}
draw();
pause(quiet || !!place);
