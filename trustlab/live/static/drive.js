// A drive of the ground robot: physics in WebAssembly at 10 Hz, what the robot's camera shows, the control panel, the gauges.
//
// drive(root, config, wasm, on): config is made by trustlab.live.runs.drive_config; `on` has row(k, values), note(text), end(summary).
// Nothing here knows where rows go.

export const STYLE = `
.tl-drive { position: relative; display: grid; grid-template-columns: minmax(0, 3fr) minmax(12em, 1fr); gap: .5em; max-width: 70em;
  font: 15px/1.4 system-ui, sans-serif; color: #1b2430; background: #fff; padding: .4em; border-radius: 6px; touch-action: none; user-select: none; }
.tl-drive:focus { outline: 3px solid #0072b2; outline-offset: -3px; }
.tl-drive canvas { display: block; will-change: transform; } /* layers of their own: the page around is not painted again with each frame */
.tl-drive .panel { display: flex; flex-direction: column; gap: .5em; }
.tl-drive .mode { font-weight: 700; font-size: 1.15em; padding: .3em .6em; border-radius: 4px; color: #fff; background: #0072b2; }
.tl-drive .mode.autonomous { background: #a04800; }
.tl-drive .suggestion { min-height: 4.4em; padding: .3em .6em; border-radius: 4px; border: 2px solid transparent; }
.tl-drive .suggestion.now { border-color: #00784f; background: #e6f6ef; }
.tl-drive button { font: inherit; padding: .3em .6em; }
.tl-drive .hint { font-size: .85em; color: #47525e; }
.tl-drive .gauges { grid-column: 1 / -1; }
.tl-drive .away { position: absolute; inset: 0; display: grid; place-items: center; background: rgba(255, 255, 255, .75); font-size: 1.3em; border-radius: 6px; }
.tl-drive .away[hidden] { display: none; }
`;

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  made.className = className;
  made.textContent = text;
  return made;
}

// Words that stand there already would be laid out again.
function say(place, words) {
  if (place.textContent !== words) place.textContent = words;
}

// The kernel: numba's tick in WebAssembly, its records in memory by the layout that the configuration states.
export class Physics {
  static async load(wasm, config) {
    const { instance } = await WebAssembly.instantiate(wasm, {});
    return new Physics(instance.exports, config);
  }

  constructor(exports, config) {
    this.exports = exports;
    this.config = config;
    const posts = config.posts.length, records = config.records;
    const needed = 16 * config.samples + 24 * config.path.length + 48 * posts + 65_536;
    exports.memory.grow(Math.ceil(needed / 65_536));
    this.memory = new DataView(exports.memory.buffer);
    this.top = exports.__heap_base.value + 64;
    const pack = (name, values) => {
      const at = this.room(records[name].size);
      for (const [field, [offset, kind]] of Object.entries(records[name].fields)) {
        if (kind === "i") this.memory.setBigInt64(at + offset, BigInt(values[field]), true);
        else this.memory.setFloat64(at + offset, values[field], true);
      }
      return at;
    };
    const numbers = (values) => {
      const at = this.room(8 * values.length);
      values.forEach((x, i) => this.memory.setFloat64(at + 8 * i, x, true));
      return at;
    };
    this.status = this.room(32);
    const world = [
      pack("task", config.task), pack("robot", config.robot), numbers(config.path.flat()), config.path.length,
      numbers(config.posts.flat()), posts, this.room(8),
    ];
    const source = pack("source", { seed: config.seed, drawn: 0 });
    const room = [this.room(8 * config.samples), this.room(8 * config.samples), this.room(32 * posts)];
    this.at = { state: this.room(records.state.size), forcing: this.room(records.forcing.size), row: this.room(records.row.size) };
    this.arguments = [...world, source, ...room, this.at.state, this.at.forcing, this.at.row];
    this.k = 0;
    exports.begin(this.status, this.status + 16, ...world, this.at.state, this.at.forcing);
  }

  room(bytes) {
    const at = (this.top + 15) & ~15;
    this.top = at + bytes;
    return at;
  }

  // Drive for one sample; return its row, an array in the order of the columns. `this.done` says whether all laps are done.
  tick(v, w, wanted) {
    if (this.exports.tick(this.status, this.status + 16, this.k, v, w, wanted, ...this.arguments) !== 0) throw new Error("the kernel failed");
    this.k += 1;
    this.done = this.memory.getInt32(this.status, true) === 1 || this.k >= this.config.samples;
    return this.config.columns.map((_, i) => this.memory.getFloat64(this.at.row + 8 * i, true));
  }

  get(name) {
    const [offset, kind] = this.config.records.state.fields[name];
    return kind === "i" ? Number(this.memory.getBigInt64(this.at.state + offset, true)) : this.memory.getFloat64(this.at.state + offset, true);
  }
}

const KEYS = {
  ArrowUp: [0, 1], KeyW: [0, 1], ArrowDown: [0, -1], KeyS: [0, -1],
  ArrowLeft: [1, 1], KeyA: [1, 1], ArrowRight: [1, -1], KeyD: [1, -1],
};

// The hands on keyboard, gamepad, mouse or finger; whichever was used last drives.
export class Hands {
  constructor(root, ramp, onBlur) {
    this.down = new Set();
    this.levers = [0, 0];
    this.ramp = ramp;
    this.pointer = null;
    this.source = "keyboard";
    this.toggles = 0;
    this.stop = new AbortController();
    const listen = (target, type, act, more = {}) => target.addEventListener(type, act, { signal: this.stop.signal, ...more });
    listen(root, "keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.code === "Tab") return;
      event.stopPropagation();          // a notebook has shortcuts of its own: an x beside the keys would cut the cell
      if (event.code === "Space") this.toggles += event.repeat ? 0 : 1;
      else if (event.code in KEYS) {
        this.down.add(event.code);
        this.source = "keyboard";
      } else return;
      event.preventDefault();
    });
    listen(root, "keyup", (event) => { this.down.delete(event.code); event.stopPropagation(); });
    listen(root, "blur", () => { this.clear(); onBlur(); });
    listen(root, "pointerdown", (event) => {
      if (event.target.closest("button")) return;
      root.focus({ preventScroll: true });
      this.pointer = { id: event.pointerId, x: event.clientX, y: event.clientY, forward: 0, left: 0 };
      this.source = "pointer";
    });
    listen(window, "pointermove", (event) => {
      if (this.pointer?.id !== event.pointerId) return;
      this.pointer.forward = clamp((this.pointer.y - event.clientY) / 80, -1, 1);
      this.pointer.left = clamp((this.pointer.x - event.clientX) / 80, -1, 1);
    });
    for (const type of ["pointerup", "pointercancel"]) listen(window, type, (event) => { if (this.pointer?.id === event.pointerId) this.pointer = null; });
  }

  clear() {
    this.down.clear();
    this.pointer = null;
    this.levers = [0, 0];
  }

  // Where forward and left stand now, each in [−1, 1]; one call per sample.
  read(seconds) {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((one) => one?.connected);
    if (pad) {
      const still = (x) => (Math.abs(x ?? 0) < 0.08 ? 0 : x);
      const axes = [-still(pad.axes[1]), -still(pad.axes[0])];
      if (axes[0] || axes[1]) this.source = "gamepad";
      const pressed = pad.buttons[0]?.pressed ?? false;
      if (pressed && !this.pressed) this.toggles += 1;
      this.pressed = pressed;
      if (this.source === "gamepad") return axes;
    }
    if (this.source === "pointer") return this.pointer ? [this.pointer.forward, this.pointer.left] : [0, 0];
    const wanted = [0, 0];
    for (const code of this.down) wanted[KEYS[code][0]] += KEYS[code][1];
    this.levers = this.levers.map((now, i) => {
      const want = clamp(wanted[i], -1, 1);
      const most = (Math.abs(want) > Math.abs(now) ? this.ramp.rise : this.ramp.fall) * seconds;
      return now + clamp(want - now, -most, most);
    });
    return this.levers;
  }
}

// A scripted hand for tests and rehearsals: steers to a point ahead on the path, wobbles, follows suggestions, switches now and then.
function script(hand, config, physics) {
  const { speed = 0.9, wobble = 0.1, ahead = 1.2, patience = 20, phase = 600 } = hand;
  const path = config.path, length = path.at(-1)[2];
  let since = 0;
  return (k, row) => {
    let s = physics.get("arc") + ahead, i = 0;
    s -= Math.floor(s / length) * length;
    while (i < path.length - 2 && path[i + 1][2] <= s) i += 1;
    const share = (s - path[i][2]) / (path[i + 1][2] - path[i][2]);
    const [x, y] = [0, 1].map((axis) => path[i][axis] + share * (path[i + 1][axis] - path[i][axis]));
    const aim = Math.atan2(y - physics.get("y"), x - physics.get("x")) - physics.get("yaw");
    const bearing = Math.atan2(Math.sin(aim), Math.cos(aim)) + wobble * Math.sin(0.09 * k);
    const now = row?.[0] ?? 1, suggested = row?.[1] ?? -1;
    since = suggested >= 0 && suggested !== now ? since + 1 : 0;
    const free = config.task.scheme === 1 && k % phase === phase - 1;
    const wanted = since > patience ? suggested : free ? 1 - now : null;
    return { forward: clamp(speed - 0.3 * Math.abs(bearing), 0, 1), left: clamp(1.6 * bearing, -1, 1), wanted };
  };
}

// Make a canvas opaque and keep its pixels those of the screen: without a graphics card scaling costs more than drawing.
function fitted(canvas, shape, resized, signal) {
  const g = canvas.getContext("2d", { alpha: false, desynchronized: true });   // shown past the page's own painting: sooner, and for less
  const fit = () => {
    const wide = Math.floor(canvas.parentElement.clientWidth), dense = Math.min(devicePixelRatio, 2);
    if (!wide || canvas.width === Math.round(wide * dense)) return;
    canvas.width = Math.round(wide * dense);
    canvas.height = Math.round(canvas.width * shape);
    canvas.style.width = `${canvas.width / dense}px`;
    canvas.style.height = `${canvas.height / dense}px`;
    resized();
  };
  const watch = new ResizeObserver(fit);
  watch.observe(canvas.parentElement);
  signal.addEventListener("abort", () => watch.disconnect());
  fit();
  return g;
}

// What the robot's camera shows: gates of posts within range, over a floor with a grid for the eye to hold on to.
class Camera {
  constructor(canvas, config, signal) {
    Object.assign(this, { config, canvas, past: [], course: config.view.map ? new CourseMap(config.path) : null });
    this.g = fitted(canvas, 11 / 24, () => { this.focal = canvas.width / 2 / Math.tan(config.view.field / 2); }, signal);
  }

  // Remember a pose; frames show the one of `delay` ago.
  add(pose) {
    this.past.push(pose);
    if (this.past.length > 60) this.past.shift();
  }

  // The pose at a time, in samples, between the poses that are remembered.
  pose(time) {
    const past = this.past, i = Math.max(past.findLastIndex((one) => one.k <= time), 0);
    const a = past[i], b = past[i + 1] ?? a, share = clamp((time - a.k) / Math.max(b.k - a.k, 1), 0, 1);
    const turn = Math.atan2(Math.sin(b.yaw - a.yaw), Math.cos(b.yaw - a.yaw));
    return { x: a.x + share * (b.x - a.x), y: a.y + share * (b.y - a.y), yaw: a.yaw + share * turn };
  }

  draw(time) {
    if (!this.past.length) return;
    const { g, canvas, config, focal } = this, { range, height, delay } = config.view;
    const at = this.pose(time - delay / config.sample_time), cos = Math.cos(at.yaw), sin = Math.sin(at.yaw);
    const horizon = Math.round(0.36 * canvas.height), middle = canvas.width / 2, aside = Math.tan(config.view.field / 2) + 0.05;
    g.fillStyle = "#cfdbe6";
    g.fillRect(0, 0, canvas.width, horizon);
    g.fillStyle = "#e9e5da";
    g.fillRect(0, horizon, canvas.width, canvas.height - horizon);
    g.fillStyle = "#b9b29f";
    for (let x = Math.floor(at.x - range); x <= at.x + range; x += 0.5) {
      for (let y = Math.floor(at.y - range); y <= at.y + range; y += 0.5) {
        const ahead = cos * (x - at.x) + sin * (y - at.y), left = cos * (y - at.y) - sin * (x - at.x);
        if (ahead < 0.35 || Math.abs(left) > aside * ahead || ahead * ahead + left * left > range * range) continue;
        const near = focal / ahead;                       // whole pixels, which need no smoothing
        g.fillRect(Math.round(middle - near * left), Math.round(horizon + near * height), Math.ceil(0.035 * near), Math.ceil(0.012 * near));
      }
    }
    const posts = [];
    config.posts.forEach(([x, y], i) => {
      const ahead = cos * (x - at.x) + sin * (y - at.y), left = cos * (y - at.y) - sin * (x - at.x), away = Math.hypot(ahead, left);
      if (ahead > 0.15 && away < range) posts.push({ ahead, left, away, i });
    });
    for (const { ahead, left, away, i } of posts.sort((a, b) => b.ahead - a.ahead)) {
      const near = focal / ahead;
      g.globalAlpha = clamp((range - away) / 0.8, 0, 1);                        // posts come out of the haze
      g.fillStyle = i % 2 ? "#0b7a55" : "#b3402e";                              // right and left of the way
      g.fillRect(middle - near * (left + 0.045), horizon + near * (height - 0.9), 0.09 * near, 0.9 * near);
    }
    g.globalAlpha = 1;
    this.course?.draw(g, at);
  }
}

// The small map for experimenters: the path, drawn once, and where the robot is.
class CourseMap {
  constructor(path) {
    const xs = path.map((p) => p[0]), ys = path.map((p) => p[1]), low = [Math.min(...xs), Math.min(...ys)];
    const scale = 150 / (Math.max(...xs) - low[0]);
    this.place = (x, y) => [10 + scale * (x - low[0]), 130 - scale * (y - low[1])];
    this.sheet = Object.assign(element("canvas"), { width: 172, height: 140 });
    const g = this.sheet.getContext("2d");
    g.fillStyle = "rgba(255,255,255,.85)";
    g.fillRect(0, 0, 172, 140);
    g.strokeStyle = "#555";
    g.beginPath();
    for (const [x, y] of path) g.lineTo(...this.place(x, y));
    g.stroke();
  }

  draw(g, at) {
    const [x, y] = this.place(at.x, at.y);
    g.drawImage(this.sheet, 0, 0);
    g.fillStyle = "#0072b2";
    g.fillRect(x - 4, y - 4, 8, 8);
  }
}

// P_r, P_h, r and TSC over the last minutes, each with its number; thresholds and best performance as lines. Drawn five times a second.
class Gauges {
  constructor(canvas, config, signal) {
    this.canvas = canvas;
    this.stale = true;
    this.g = fitted(canvas, 1 / 8, () => { this.stale = true; }, signal);
    const { task, columns } = config, top = 1.25 * config.robot.max_speed;
    const tsc = task.scheme === 2 ? [task.lower, task.upper] : [];
    const shown = [["p_r", "robot P_r", 0, top, task.p_max ? [task.p_max] : []], ["p_h", "you P_h", 0, top, []], ["r", "how busy, r", 0, 1, []], ["tsc", "trust, TSC", -1, 1, tsc]];
    this.panels = shown.filter(([name]) => task.a_T || name !== "tsc").map(([name, label, low, high, lines]) => ({ at: columns.indexOf(name), label, low, high, lines, past: [] }));
  }

  add(row) {
    for (const panel of this.panels) {
      panel.past.push(row[panel.at]);
      if (panel.past.length > 1800) panel.past.shift();        // three minutes
    }
    this.added = (this.added ?? 0) + 1;
    this.stale ||= this.added % 2 === 0;
  }

  draw() {
    if (!this.stale) return;
    this.stale = false;
    const g = this.g, wide = 960 / this.panels.length, size = this.canvas.width / 960;
    g.setTransform(size, 0, 0, size, 0, 0);
    g.fillStyle = "#fff";
    g.fillRect(0, 0, 960, 120);
    g.font = "16px system-ui, sans-serif";
    this.panels.forEach(({ label, low, high, lines, past }, i) => {
      const x = i * wide + 8, y = (value) => 112 - (84 * (clamp(value, low, high) - low)) / (high - low);
      g.fillStyle = "#f1f4f7";
      g.fillRect(x, 28, wide - 16, 84);
      g.strokeStyle = "#a04800";
      for (const line of lines) { g.beginPath(); g.moveTo(x, y(line)); g.lineTo(x + wide - 16, y(line)); g.stroke(); }
      g.strokeStyle = "#0072b2";
      g.beginPath();
      for (let n = 0; n < past.length; n += 6) g.lineTo(x + ((wide - 16) * n) / 1800, y(past[n]));
      g.stroke();
      g.fillStyle = "#1b2430";
      g.fillText(`${label}  ${past.length ? past.at(-1).toFixed(2) : ""}`, x, 20);
    });
  }
}

const NAMES = ["AUTONOMOUS", "MANUAL"];

// Why the panel suggests a mode, in words.
function reason(config, suggested, row) {
  const { task, columns } = config, tsc = row[columns.indexOf("tsc")].toFixed(2), p = row[columns.indexOf("p_r")].toFixed(2);
  if (task.scheme === 2) return suggested ? `trust has fallen: TSC ${tsc}, manual at ${task.lower.toFixed(2)}` : `trust has risen: TSC ${tsc}, autonomous at ${task.upper.toFixed(2)}`;
  return suggested ? `the robot performs below its best: P_r ${p} of ${task.p_max.toFixed(2)} m/s` : `the robot performs at its best: P_r ${p} m/s`;
}

class Panel {
  constructor(root, config, toggle) {
    this.config = config;
    this.mode = element("div", "mode");
    this.suggestion = element("div", "suggestion");
    this.suggestion.setAttribute("role", "status");
    this.button = element("button", "", "Switch (space bar)");
    this.button.addEventListener("click", () => { toggle(); root.focus({ preventScroll: true }); });
    this.clock = element("div", "hint");
    const hint = element("div", "hint", "Arrow keys or W A S D, a gamepad, or drag with mouse or finger. Stay between the posts, as fast as you can: red ones on your left.");
    this.root = element("div", "panel");
    this.root.append(this.mode, this.button, this.suggestion, this.clock, hint);
  }

  show(row, laps) {
    const [mode, suggested] = row, { task } = this.config, stands = suggested >= 0 && suggested !== mode;
    say(this.mode, NAMES[mode]);
    this.mode.classList.toggle("autonomous", mode === 0);
    this.suggestion.classList.toggle("now", stands);
    const said = stands ? `${task.forced ? "Switching to" : "Suggested:"} ${NAMES[suggested]}. ${reason(this.config, suggested, row)}.` : "";
    say(this.suggestion, said);
    say(this.clock, task.laps ? `Lap ${Math.min(laps + 1, task.laps)} of ${task.laps}` : "");
  }
}

function wanting(config) {
  const ends = [];
  for (const [mode, seconds] of config.schedule ?? []) ends.push([mode, (ends.at(-1)?.[1] ?? 0) + seconds]);
  return (k) => (ends.find(([, end]) => k * config.sample_time < end) ?? ends.at(-1))?.[0] ?? null;
}

function furnish(root, config, toggle, signal) {
  const sheet = new CSSStyleSheet(), home = root.getRootNode();
  sheet.replaceSync(STYLE);
  home.adoptedStyleSheets = [...(home.adoptedStyleSheets ?? []), sheet];
  root.classList.add("tl-drive");
  root.tabIndex = 0;
  const camera = element("canvas"), gauges = element("canvas"), away = element("div", "away", "Paused: click here to go on");
  const panel = new Panel(root, config, toggle), front = element("div"), below = element("div", "gauges");
  camera.setAttribute("aria-label", "what the robot's camera shows");
  gauges.setAttribute("aria-label", "performance, utilization and trust over the last minutes");
  away.hidden = true;
  front.append(camera);
  below.append(gauges);
  root.replaceChildren(front, panel.root, below, away);
  root.focus({ preventScroll: true });
  return { camera: new Camera(camera, config, signal), gauges: new Gauges(gauges, config, signal), panel, away };
}

export async function drive(root, config, wasm, on) {
  const physics = await Physics.load(wasm, config), dt = (1000 * config.sample_time) / (config.pace ?? 1), scheduled = wanting(config);
  let wanted = config.task.first_mode, row = null, running = true, paused = null, last = performance.now(), behind = 0, frames = [], stamps = [], timer = 0;
  const hands = new Hands(root, config.ramp, () => running && on.note("focus lost: keys released"));
  const hand = config.hand ? script(config.hand, config, physics) : null, leaving = new AbortController();
  const { camera, gauges, panel, away } = furnish(root, config, () => { hands.toggles += 1; }, leaving.signal);
  let shown = null;

  function take(v, w) {
    row = physics.tick(v, w, scheduled(physics.k) ?? wanted);
    // A wish is not kept where it cannot be met now: before the window is full, or without the suggestion that must be followed.
    if (config.task.forced || physics.k * config.sample_time <= config.task.settling) wanted = row[0];
    camera.add({ k: physics.k, x: physics.get("x"), y: physics.get("y"), yaw: physics.get("yaw") });
    gauges.add(row);
    return row;
  }

  function sample() {
    const scripted = hand?.(physics.k, row), [forward, left] = scripted ? [scripted.forward, scripted.left] : hands.read(config.sample_time);
    if (hands.toggles % 2) wanted = 1 - (row?.[0] ?? wanted);
    hands.toggles = 0;
    if (scripted && scripted.wanted !== null) wanted = scripted.wanted;
    const k = physics.k;
    take(Math.max(forward, 0) * config.robot.max_speed, left * config.robot.max_turn_rate);
    stamps.push(performance.now());
    on.row(k, row);
    if (physics.done) finish("complete");
  }

  function finish(why) {
    if (!running) return;
    stop();
    draw();
    on.end({ rows: physics.k, laps: physics.get("laps"), why });
  }

  function stop() {
    running = false;
    clearInterval(timer);
    hands.stop.abort();
    leaving.abort();
  }

  function draw() {
    camera.draw(physics.k + behind / dt);
    gauges.draw();
    if (row !== shown) panel.show((shown = row), physics.get("laps"));
  }

  // Samples that are due by the clock. A gap, in which the page slept, is a pause of the robot, and is logged as one.
  function advance() {
    const now = performance.now(), gap = now - last;
    last = now;
    if (!running || paused !== null) return;
    if (gap > 250) {
      on.note(`pause of ${(gap / 1000).toFixed(2)} s: the page did not run`);
      return;
    }
    behind += gap;
    while (running && behind >= dt) { behind -= dt; sample(); }
  }

  function pause(why = "paused") {
    if (!running || paused !== null) return;
    paused = performance.now();
    hands.clear();
    away.hidden = false;
    on.note(`pause begins: ${why}`);
  }

  function resume() {
    if (paused === null) return;
    on.note(`pause ends after ${((performance.now() - paused) / 1000).toFixed(2)} s`);
    [paused, last, behind, away.hidden] = [null, performance.now(), 0, true];
    root.focus({ preventScroll: true });
  }

  function frame(now) {
    if (!running) return;
    frames.push(now);
    if (frames.length > 600) frames.shift();
    advance();
    if (running) draw();
    requestAnimationFrame(frame);
  }

  // Go on behind rows that were driven before: the same commands give the same rows.
  function resume_from(rows) {
    const at = ["v_command", "w_command", "mode"].map((name) => config.columns.indexOf(name));
    for (const earlier of rows) {
      wanted = earlier[at[2]];
      take(earlier[at[0]], earlier[at[1]]);
    }
    if (physics.done) finish("complete");
  }

  // How the page keeps up: frames a second, the log's period [s], and what the hands are on.
  function telemetry() {
    const periods = stamps.slice(1).map((x, i) => x - stamps[i]).sort((a, b) => a - b);
    const fps = frames.length > 1 ? (1000 * (frames.length - 1)) / (frames.at(-1) - frames[0]) : 0;
    return { fps, rows: physics.k, source: hands.source, period_median: (periods[periods.length >> 1] ?? 0) / 1000, period_max: (periods.at(-1) ?? 0) / 1000 };
  }

  away.addEventListener("click", () => { if (!document.hidden) resume(); }, { signal: leaving.signal });
  document.addEventListener("visibilitychange", () => (document.hidden ? pause("the page is hidden") : resume()), { signal: leaving.signal });
  if (config.rows?.length) resume_from(config.rows);
  const rush = () => {                                         // tests and rehearsals: as fast as the kernel goes
    for (let n = 0; running && paused === null && n < 200; n += 1) sample();
    if (running) setTimeout(rush, 0);
  };
  if (running && config.clock === "accelerated") setTimeout(rush, 0);
  else if (running) {
    timer = setInterval(advance, 40);                          // beside frames, which a busy machine may hold back
    requestAnimationFrame(frame);
  }
  return { stop, pause, resume, resume_from, telemetry, physics, hands, get row() { return row; } };
}
