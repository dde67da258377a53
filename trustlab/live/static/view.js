// What a driver sees: camera, gauges and panel.
import { clamp, addStyle, element, filled, keepKeys, say, stroke } from "./page.js";

export const STYLE = `
.tl-drive {
  position: relative; display: grid; grid-template-columns: minmax(0, 3fr) minmax(12em, 1fr);
  gap: .5em; max-width: 70em;
  font: 15px/1.4 system-ui, sans-serif; color: #1b2430; background: #fff; padding: .4em;
  border-radius: 6px; touch-action: none; user-select: none; }
.tl-drive:focus { outline: 3px solid #0072b2; outline-offset: -3px; }
.tl-drive canvas {
  /* layers of their own: the page around is not painted again with each frame */
  display: block; will-change: transform;
}
.tl-drive .panel { display: flex; flex-direction: column; gap: .5em; }
.tl-drive .mode {
  font-weight: 700; font-size: 1.15em; padding: .3em .6em; border-radius: 4px; color: #fff;
  background: #0072b2;
}
.tl-drive .mode.autonomous { background: #a04800; }
.tl-drive .suggestion {
  min-height: 4.4em; padding: .3em .6em; border-radius: 4px; border: 2px solid transparent;
}
.tl-drive .suggestion.now { border-color: #00784f; background: #e6f6ef; }
.tl-drive button { font: inherit; padding: .3em .6em; }
.tl-drive .hint { font-size: .85em; color: #47525e; }
.tl-drive .gauges { grid-column: 1 / -1; }
.tl-drive .away {
  position: absolute; inset: 0; display: grid; place-items: center;
  background: rgba(255, 255, 255, .75); font-size: 1.3em; border-radius: 6px;
}
.tl-drive .away[hidden] { display: none; }
@media (max-width: 700px) {
  .tl-drive { grid-template-columns: minmax(0, 1fr); }
  .tl-drive .suggestion { min-height: 3em; }
}
`;

// Make a canvas opaque and keep its pixels those of the screen: without a graphics card scaling
// costs more than drawing.
function fitted(canvas, shape, signal) {
  // Shown past the page's own painting: sooner, and for less
  const g = canvas.getContext("2d", { alpha: false, desynchronized: true });
  const fit = () => {
    const wide = Math.floor(canvas.parentElement.clientWidth),
      dense = Math.min(devicePixelRatio, 2);
    if (!wide || canvas.width === Math.round(wide * dense)) return;
    canvas.width = Math.round(wide * dense);
    canvas.height = Math.round(canvas.width * shape);
    canvas.style.width = `${canvas.width / dense}px`;
    canvas.style.height = `${canvas.height / dense}px`;
  };
  const watch = new ResizeObserver(fit);
  watch.observe(canvas.parentElement);
  signal.addEventListener("abort", () => watch.disconnect());
  fit();
  return g;
}

// What the robot's camera shows: gates of posts within range, over a floor with a grid for the eye
// to hold on to.
export class Camera {
  constructor(canvas, config, signal) {
    Object.assign(this, { config, canvas });
    this.g = fitted(canvas, 11 / 24, signal);
  }

  // Draw what is seen from a pose.
  draw(at) {
    const { g, canvas, config } = this,
      { range, height } = config.view,
      cos = Math.cos(at.yaw),
      sin = Math.sin(at.yaw);
    const seen = ([x, y]) => ({
      ahead: cos * (x - at.x) + sin * (y - at.y),
      left: cos * (y - at.y) - sin * (x - at.x),
    });
    const horizon = Math.round(0.36 * canvas.height),
      middle = canvas.width / 2,
      edge = Math.tan(config.view.field / 2),
      focal = middle / edge;
    g.fillStyle = "#cfdbe6";
    g.fillRect(0, 0, canvas.width, horizon);
    g.fillStyle = "#e9e5da";
    g.fillRect(0, horizon, canvas.width, canvas.height - horizon);
    g.fillStyle = "#b9b29f";
    for (let x = Math.floor(at.x - range); x <= at.x + range; x += 0.5) {
      for (let y = Math.floor(at.y - range); y <= at.y + range; y += 0.5) {
        const { ahead, left } = seen([x, y]);
        const inside = Math.abs(left) <= (edge + 0.05) * ahead;
        if (ahead < 0.35 || !inside || Math.hypot(ahead, left) > range) continue;
        const near = focal / ahead; // whole pixels, which need no smoothing
        g.fillRect(
          Math.round(middle - near * left),
          Math.round(horizon + near * height),
          Math.ceil(0.035 * near),
          Math.ceil(0.012 * near),
        );
      }
    }
    const posts = config.posts.map((post, i) => ({ ...seen(post), i }));
    for (const { ahead, left, i } of posts.sort((a, b) => b.ahead - a.ahead)) {
      const near = focal / ahead;
      if (ahead <= 0.15) continue;
      // Posts come out of the haze.
      g.globalAlpha = clamp((range - Math.hypot(ahead, left)) / 0.8, 0, 1);
      g.fillStyle = i % 2 ? "#0b7a55" : "#b3402e"; // right and left of the way
      g.fillRect(
        middle - near * (left + 0.045),
        horizon + near * (height - 0.9),
        0.09 * near,
        0.9 * near,
      );
    }
    g.globalAlpha = 1;
  }
}

// P_r, P_h, r and TSC over the last minutes, each with its number; thresholds and best performance
// as lines. Drawn five times a second.
export class Gauges {
  constructor(canvas, config, signal) {
    Object.assign(this, { canvas, added: 0, drawn: "" });
    this.g = fitted(canvas, 1 / 8, signal);
    const { task, columns, words } = config,
      top = 1.25 * config.robot.max_speed;
    const tsc = task.scheme === 2 ? [task.lower, task.upper] : [];
    const gauge = (name, label, low, high, lines = []) => ({
      at: columns.indexOf(name),
      grows: name === "tsc", // TSC has no limits of its own
      ...{ label, low, high, lines, past: [] },
    });
    this.panels = [
      gauge("p_r", words.gauge_robot, 0, top, task.p_max ? [task.p_max] : []),
      gauge("p_h", words.gauge_person, 0, top),
      gauge("r", words.gauge_utilization, 0, 1),
    ];
    if (task.a_T)
      this.panels.push(
        gauge("tsc", words.gauge_trust, Math.min(-1, ...tsc), Math.max(1, ...tsc), tsc),
      );
  }

  add(row) {
    for (const panel of this.panels) {
      const value = row[panel.at];
      panel.past.push(value);
      if (panel.grows) {
        panel.low = Math.min(panel.low, value);
        panel.high = Math.max(panel.high, value);
      }
      if (panel.past.length > 1800) panel.past.shift(); // three minutes
    }
    this.added += 1;
  }

  draw() {
    const state = `${this.added >> 1} ${this.canvas.width}`; // resizing clears a canvas
    if (this.drawn === state) return;
    this.drawn = state;
    const g = this.g,
      wide = 960 / this.panels.length,
      size = this.canvas.width / 960;
    g.setTransform(size, 0, 0, size, 0, 0);
    g.fillStyle = "#fff";
    g.fillRect(0, 0, 960, 120);
    g.font = "16px system-ui, sans-serif";
    this.panels.forEach(({ label, low, high, lines, past }, i) => {
      const x = i * wide + 8,
        y = (value) => 112 - (84 * (clamp(value, low, high) - low)) / (high - low);
      g.fillStyle = "#f1f4f7";
      g.fillRect(x, 28, wide - 16, 84);
      for (const line of lines)
        stroke(g, "#a04800", 1, [x, y(line)], [x + wide - 16, y(line)]);
      g.strokeStyle = "#0072b2";
      g.beginPath();
      for (let n = 0; n < past.length; n += 6) g.lineTo(x + ((wide - 16) * n) / 1800, y(past[n]));
      g.stroke();
      g.fillStyle = "#1b2430";
      g.fillText(`${label}  ${past.length ? past.at(-1).toFixed(2) : ""}`, x, 20);
    });
  }
}

// Why the panel suggests a mode, in words.
export function reason(config, suggested, row) {
  const { task, columns, words } = config;
  const values = {
    tsc: row[columns.indexOf("tsc")].toFixed(2),
    p_r: row[columns.indexOf("p_r")].toFixed(2),
    lower: task.lower.toFixed(2),
    upper: task.upper.toFixed(2),
    best: task.p_max.toFixed(2),
  };
  if (task.scheme === 2)
    return filled(suggested ? words.trust_has_fallen : words.trust_has_risen, values);
  if (task.scheme === 5) return words.rule_suggests;
  return filled(suggested ? words.below_its_best : words.at_its_best, values);
}

// Why nobody may switch in this sample, in words; "" where they may.
export function refusal(config, k, row) {
  const { task, words } = config,
    { settling } = config.switching,
    rest = settling - k * config.sample_time;
  if (config.schedule) return words.by_itself;
  if (rest > 0) {
    const values = { seconds: Math.ceil(rest), settling };
    return filled(words.too_early, values);
  }
  const [mode, suggested] = row ?? [task.first_mode, -1];
  return task.forced && (suggested < 0 || suggested === mode) ? words.only_suggested : "";
}

// How long the panel says why nothing was switched [ms].
const EXPLAINED = 4000;

export class Panel {
  constructor(root, config, toggle) {
    const { words } = config;
    this.config = config;
    this.explained = { words: "", until: 0 };
    this.mode = element("div", { className: "mode" });
    this.suggestion = element("div", { className: "suggestion", role: "status" });
    const press = () => {
      toggle();
      root.focus({ preventScroll: true });
    };
    this.button = element("button", { textContent: words.switch, onclick: press });
    keepKeys(this.button);
    this.clock = element("div", { className: "hint" });
    const hint = element("div", { className: "hint", textContent: words.hint });
    const parts = [this.mode, this.button, this.suggestion, this.clock, hint];
    this.root = element("div", { className: "panel" }, ...parts);
  }

  // Say for some seconds why nothing was switched.
  explain(words) {
    this.explained = { words, until: performance.now() + EXPLAINED };
  }

  show(row, laps) {
    const [mode, suggested] = row,
      { task, words } = this.config,
      names = [words.autonomous, words.manual],
      stands = suggested >= 0 && suggested !== mode;
    say(this.mode, names[mode]);
    this.mode.classList.toggle("autonomous", mode === 0);
    this.suggestion.classList.toggle("now", stands);
    let text = performance.now() < this.explained.until ? this.explained.words : "";
    if (stands) {
      const lead = task.forced ? words.switching_to : words.suggested;
      text = `${filled(lead, { mode: names[suggested] })} ${reason(this.config, suggested, row)}`;
    }
    say(this.suggestion, text);
    const lap = Math.min(laps + 1, task.laps);
    say(this.clock, task.laps ? filled(words.lap, { lap, laps: task.laps }) : "");
  }
}

export function furnish(root, config, toggle, signal) {
  const { words } = config;
  addStyle(root, STYLE);
  root.classList.add("tl-drive");
  root.tabIndex = 0;
  const camera = element("canvas", { ariaLabel: words.camera }),
    gauges = element("canvas", { ariaLabel: words.gauges }),
    away = element("div", { className: "away", textContent: words.waiting, hidden: true }),
    panel = new Panel(root, config, toggle),
    below = element("div", { className: "gauges" }, gauges);
  root.replaceChildren(element("div", {}, camera), panel.root, below, away);
  root.focus({ preventScroll: true });
  return {
    camera: new Camera(camera, config, signal),
    gauges: new Gauges(gauges, config, signal),
    panel,
    away,
  };
}
