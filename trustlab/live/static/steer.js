// A task that a hand steers in a square, twenty commands a second. Commands go to the server or a
// notebook's kernel, which computes the task, and what comes back is drawn; or to a run that is
// computed here.
//
// steer(root, config, on, run) has the contract of drive.js; heard(answer) takes what the other
// side says: {have, picture}.
import { MIDDLE, PAD_STYLE, SIZE, Stick, dot, drawPad, drawPicture } from "./pad.js";
import { clamp, dress, element, filled, keepKeys, say } from "./page.js";

const MOST_AHEAD = 10; // commands unanswered before the page waits
const COLOURS = ["#0072b2", "#a04800", "#00784f", "#8a3b8f", "#8c6d00", "#47525e"];

// The field from above: the goal, and the robots with their numbers; a ring is around the leader.
function drawField(g, config, now) {
  const scale = MIDDLE / config.field,
    place = ([x, y]) => [MIDDLE + scale * x, MIDDLE - scale * y],
    [x, y] = place(now.goal);
  g.clearRect(0, 0, SIZE, SIZE);
  g.strokeStyle = g.fillStyle = "#1b2430";
  g.lineWidth = 3;
  g.beginPath();
  g.moveTo(x, y);
  g.lineTo(x, y - 26);
  g.lineTo(x + 16, y - 20);
  g.lineTo(x, y - 14);
  g.stroke();
  g.setLineDash([4, 4]);
  g.beginPath();
  g.arc(x, y, scale * config.tolerance, 0, 2 * Math.PI);
  g.stroke();
  g.setLineDash([]);
  g.font = "bold 16px system-ui, sans-serif";
  g.textAlign = "center";
  now.robots.forEach((robot, i) => {
    const at = place(robot);
    dot(g, at, 11, COLOURS[i]);
    g.fillStyle = "#fff";
    g.fillText(i + 1, at[0], at[1] + 6);
    if (now.leader !== i + 1) return;
    g.strokeStyle = COLOURS[i];
    g.beginPath();
    g.arc(...at, 17, 0, 2 * Math.PI);
    g.stroke();
  });
}

// What the team's page says and offers: who leads, how much each robot is trusted, who may choose.
class Choice {
  constructor(place, config, signal, root) {
    const { words } = config;
    Object.assign(this, { config, words, value: 0, suggested: 0 });
    this.line = element("div");
    this.buttons = config.start.map((_, i) => {
      const button = element("button", { type: "button", disabled: !config.chooses });
      button.style.borderLeft = `.8em solid ${COLOURS[i]}`;
      button.addEventListener("click", () => {
        this.choose(i + 1);
        root.focus({ preventScroll: true });
      });
      keepKeys(button);
      return button;
    });
    this.says = element("div", { className: "suggestion" });
    this.says.setAttribute("role", "status");
    place.append(...this.buttons, this.line, this.says);
    root.addEventListener(
      "keydown",
      (event) => {
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        event.stopPropagation();
        const number = Number(event.key);
        if (event.code === "Space") this.choose(this.suggested);
        else if (number >= 1 && number <= config.start.length) this.choose(number);
        else return;
        event.preventDefault();
      },
      { signal },
    );
  }

  choose(number) {
    if (this.config.chooses && number) this.value = number;
  }

  show(now) {
    const { words, config } = this,
      values = { robot: now.leader, goal: now.reached + 1, goals: config.goals.length };
    this.suggested = now.suggested;
    this.buttons.forEach((button, i) => {
      say(button, `${i + 1}: ${Math.round(100 * now.trust[i])} %`);
      button.style.outline = now.leader === i + 1 ? `3px solid ${COLOURS[i]}` : "";
    });
    values.goal = Math.min(values.goal, values.goals);
    const wait = now.wait > 0.05 ? { seconds: now.wait.toFixed(0) } : null;
    const leads = filled(words.leads, values),
      left = wait ? filled(words.switch_in, wait) : "";
    say(this.line, `${filled(words.goal_of, values)} · ${leads} ${left}`);
    const robot = { robot: now.suggested, robots: config.start.length };
    const rule = config.chooses ? filled(words.may_choose, robot) : words.rule_chooses;
    say(this.says, now.suggested ? filled(words.suggested_leader, robot) : rule);
  }
}

// The share of the control that a person allocates, by the wheel or the right trigger.
class Share {
  constructor(place, config, signal, root) {
    this.words = config.words;
    this.value = config.allocates ? 1 : -1;
    this.line = element("div");
    place.append(this.line);
    if (!config.allocates) return;
    const turn = (event) => {
      event.preventDefault();
      this.value = clamp(this.value - 0.05 * Math.sign(event.deltaY), 0, 1);
    };
    root.addEventListener("wheel", turn, { signal, passive: false });
  }

  read(pad) {
    const trigger = pad?.buttons[7]?.value ?? 0;
    if (this.value >= 0 && trigger > 0.02) this.value = 1 - trigger;
  }

  show() {
    const percent = Math.round(100 * this.value);
    say(this.line, this.value < 0 ? "" : filled(this.words.share, { percent }));
  }
}

// A scripted hand for tests and rehearsals: towards the goal, or where the target is.
function pulled(now, hand) {
  if (!now) return [0, 0];
  const from = now.robots?.[Math.max(now.leader - 1, 0)] ?? [0, 0],
    to = now.goal ?? now.target ?? [0, 0];
  return [0, 1].map((axis) => clamp(hand.speed * (to[axis] - from[axis]), -1, 1));
}

function furnishTask(root, config) {
  dress(root, PAD_STYLE);
  root.className = "tl-track";
  root.tabIndex = 0;
  keepKeys(root);
  const { words } = config,
    left = element("canvas", { className: "picture", width: SIZE, height: SIZE }),
    right = element("canvas", { className: "pad", width: SIZE, height: SIZE }),
    below = element("div", { className: "below" }),
    status = element("div", { className: "status" }),
    hint = config.goals ? words.lead_hint : words.fly_hint;
  status.setAttribute("role", "status");
  left.setAttribute("aria-label", words.picture);
  right.setAttribute("aria-label", words.square);
  below.append(status);
  const explained = element("div", { className: "hint", textContent: hint });
  root.replaceChildren(left, right, below, explained);
  root.focus({ preventScroll: true });
  return { left: left.getContext("2d"), right, below, status };
}

export async function steer(root, config, on, run = null) {
  const dt = (1000 * config.sample_time) / (config.pace ?? 1),
    leaving = new AbortController(),
    signal = leaving.signal,
    { left, right, below, status } = furnishTask(root, config),
    pad = right.getContext("2d"),
    stick = new Stick(right, signal),
    extra = new (config.goals ? Choice : Share)(below, config, signal, root),
    frames = [];
  let now = null,
    k = config.rows?.length ?? 0,
    have = k,
    running = true,
    last = performance.now(),
    behind = 0,
    hand = [0, 0],
    largest = 0.1; // the arrow's scale [N] grows with the forces

  function command() {
    hand = config.hand ? pulled(now, config.hand) : stick.read();
    extra.read?.(stick.pad);
    const values = [...hand, extra.value];
    on.row(k, run ? run.step(values) : values);
    k += 1;
    if (run) heard({ have: k, picture: run.picture() });
  }

  const mayGo = () => running && k < config.samples && k - have < MOST_AHEAD;

  function advance() {
    const at = performance.now(),
      gap = at - last;
    last = at;
    if (!running || document.hidden) return;
    if (gap > 250) return on.note(`pause of ${(gap / 1000).toFixed(2)} s: the page did not run`);
    behind += gap;
    while (behind >= dt && mayGo()) {
      behind -= dt;
      command();
    }
    behind = Math.min(behind, dt); // while it waits for answers, the task stands still
  }

  function drawSquare() {
    drawPad(pad, hand, { device: now.device ?? hand, guide: now.guide ?? now.force }, largest);
  }

  function draw() {
    if (!now || now.over) return say(status, now?.over ?? config.words.waiting);
    const force = now.guide ?? now.force,
      size = Math.hypot(...force);
    largest = Math.max(largest, size);
    (config.goals ? drawField : drawPicture)(left, config, now);
    drawSquare();
    stick.rumble(size / largest); // a vibration cue: it has no direction
    extra.show(now);
    const seconds = Math.max(config.duration - now.t, 0).toFixed(0);
    const remaining = filled(config.words.time_left, { seconds });
    say(status, k - have < MOST_AHEAD ? remaining : config.words.waiting);
  }

  function heard(answer) {
    have = Math.max(have, answer.have ?? 0);
    if (!answer.picture) return;
    now = answer.picture;
    draw();
    if (now.done && have === now.k && running) {
      stop();
      on.end({ rows: have, why: "complete" });
    }
  }

  function stop() {
    running = false;
    clearInterval(timer);
    leaving.abort();
  }

  function frame(at) {
    if (!running) return;
    frames.push(at);
    if (frames.length > 600) frames.shift();
    if (config.clock !== "accelerated") advance();
    if (now && !now.over) drawSquare();
    requestAnimationFrame(frame);
  }

  // Tests and rehearsals go as fast as they are answered, or computed.
  const rush = () => {
    for (let n = 0; mayGo() && n < 200; n += 1) command();
  };
  const timer = setInterval(config.clock === "accelerated" ? rush : advance, 20);
  document.addEventListener(
    "visibilitychange",
    () => on.note(document.hidden ? "the page is hidden" : "the page is seen again"),
    { signal },
  );
  const earlier = (config.rows ?? []).map((row) => row.slice(0, config.commands.length));
  if (run && have) {
    earlier.forEach((values) => run.step(values)); // the same commands give the same rows
    heard({ have, picture: run.picture() });
  } else if (have) on.row(have - 1, earlier.at(-1)); // its answer brings the picture
  requestAnimationFrame(frame);
  const telemetry = () => ({
    fps: frames.length > 1 ? (1000 * (frames.length - 1)) / (frames.at(-1) - frames[0]) : 0,
    rows: k,
  });
  return {
    stop,
    heard,
    telemetry,
    stick,
    extra,
    get now() {
      return now;
    },
  };
}
