// What a person does and sees in each task.
//
// TASKS[name](root, config, signal, note) returns: moving, what is interpolated between pictures;
// command(newest), the person's command; heard(newest); draw(picture, near, newest), with the
// picture as late as the camera, and as late as the connection alone; wait(on), it stands still.
import { Hands } from "./hands.js";
import { MIDDLE, PAD_STYLE, SIZE, Stick, dot, drawPad, drawPicture } from "./pad.js";
import { clamp, addStyle, element, filled, gamepad, keepKeys, say, stroke } from "./page.js";
import { furnish, refusal } from "./view.js";

const COLOURS = ["#0072b2", "#a04800", "#00784f", "#8a3b8f", "#8c6d00", "#47525e"];

function groundRobot(root, config, signal, note) {
  const hands = new Hands(root, config.ramp, () => note("focus lost: keys released"), signal),
    toggle = () => (hands.toggles += 1),
    { camera, gauges, panel, away } = furnish(root, config, toggle, signal),
    { max_speed, max_turn_rate } = config.robot;
  let wanted = null, // after a reload, what was wanted before
    shown = null;
  away.textContent = config.words.waiting;

  return {
    moving: ["x", "y", "yaw"],
    command(newest) {
      const { k, row } = newest,
        [forward, left] = hands.read(config.sample_time);
      if (hands.toggles % 2) {
        const words = refusal(config, k, row);
        if (words) panel.explain(words);
        else wanted = 1 - (row?.[0] ?? wanted);
      }
      hands.toggles = 0;
      return [Math.max(forward, 0) * max_speed, left * max_turn_rate, wanted];
    },
    heard({ k, row }) {
      wanted ??= row ? row[0] : config.task.first_mode;
      if (!row) return;
      gauges.add(row);
      // A wish is not kept where it cannot be met now: before the window is full, or without the
      // suggestion that must be followed.
      const early = k * config.sample_time <= config.switching.settling;
      if (config.task.forced || early) wanted = row[0];
    },
    draw(picture, near, newest) {
      camera.draw(picture);
      gauges.draw();
      if (newest.row && newest !== shown) panel.show(newest.row, newest.laps);
      shown = newest;
    },
    wait: (on) => (away.hidden = !on),
  };
}

// Two squares: what is steered, and the hand; and lines below.
class Squares {
  constructor(root, config, signal, hint) {
    const { words } = config,
      size = { width: SIZE, height: SIZE },
      left = element("canvas", { className: "picture", ariaLabel: words.picture, ...size }),
      right = element("canvas", { className: "pad", ariaLabel: words.square, ...size });
    this.status = element("div", { className: "status", role: "status" });
    this.below = element("div", { className: "below" }, this.status);
    addStyle(root, PAD_STYLE);
    root.className = "tl-track";
    root.tabIndex = 0;
    keepKeys(root);
    const explained = element("div", { className: "hint", textContent: hint });
    root.replaceChildren(left, right, this.below, explained);
    root.focus({ preventScroll: true });
    Object.assign(this, { config, still: false, largest: 0.1 }); // the arrow's scale [N] grows
    this.stick = new Stick(right, signal);
    this.view = left.getContext("2d");
    this.pad = right.getContext("2d");
  }

  draw(device, force, k) {
    const { config, stick } = this,
      size = Math.hypot(...force);
    this.largest = Math.max(this.largest, size);
    drawPad(this.pad, stick.read(), { device, guide: force }, this.largest);
    // A vibration cue: it has no direction.
    stick.rumble(size / this.largest);
    const seconds = Math.max((config.samples - k) * config.sample_time, 0).toFixed(0);
    const left = filled(config.words.time_left, { seconds });
    say(this.status, this.still ? config.words.waiting : left);
  }
}

function teleoperation(root, config, signal) {
  const squares = new Squares(root, config, signal, config.words.fly_hint),
    line = element("div");
  let share = null;
  squares.below.append(line);
  const turn = (event) => {
    event.preventDefault();
    share = clamp(share - 0.05 * Math.sign(event.deltaY), 0, 1);
  };
  if (config.allocates) root.addEventListener("wheel", turn, { signal, passive: false });

  return {
    moving: ["target", "robot", "device", "guide"],
    command() {
      const trigger = gamepad()?.buttons[7]?.value ?? 0;
      if (config.allocates && trigger > 0.02) share = 1 - trigger;
      return [...squares.stick.read(), share];
    },
    heard: (newest) => (share ??= newest.share), // after a reload, what it was before
    draw(picture, near, newest) {
      drawPicture(squares.view, config, picture);
      squares.draw(near.device, near.guide, newest.k);
      const percent = Math.round(100 * share);
      say(line, share < 0 ? "" : filled(config.words.share, { percent }));
    },
    wait: (on) => (squares.still = on),
  };
}

// The field from above: the goal, and the robots with their numbers; a ring is around the leader.
function drawField(g, config, { goal, robots, leader }) {
  const scale = MIDDLE / config.field,
    place = ([x, y]) => [MIDDLE + scale * x, MIDDLE - scale * y],
    [x, y] = place(goal);
  g.clearRect(0, 0, SIZE, SIZE);
  stroke(g, "#1b2430", 3, [x, y], [x, y - 26], [x + 16, y - 20], [x, y - 14]);
  g.setLineDash([4, 4]);
  g.beginPath();
  g.arc(x, y, scale * config.tolerance, 0, 2 * Math.PI);
  g.stroke();
  g.setLineDash([]);
  g.font = "bold 16px system-ui, sans-serif";
  g.textAlign = "center";
  const draw = (i) => {
    const at = place(robots[i]);
    dot(g, at, 11, COLOURS[i]);
    g.fillStyle = "#fff";
    g.fillText(i + 1, at[0], at[1] + 6);
    return at;
  };
  robots.forEach((_, i) => draw(i));
  if (!leader) return;
  g.strokeStyle = COLOURS[leader - 1];
  g.beginPath();
  g.arc(...draw(leader - 1), 17, 0, 2 * Math.PI); // over the others
  g.stroke();
}

function team(root, config, signal) {
  const { words } = config,
    squares = new Squares(root, config, signal, words.lead_hint),
    line = element("div"),
    says = element("div", { className: "suggestion", role: "status" }),
    robots = config.start.length;
  let choice = 0,
    suggested = 0;
  const choose = (number) => {
    if (config.chooses && number) choice = number;
  };
  const buttons = config.start.map((_, i) => {
    const onclick = () => {
      choose(i + 1);
      root.focus({ preventScroll: true });
    };
    const button = element("button", { type: "button", disabled: !config.chooses, onclick });
    button.style.borderLeft = `.8em solid ${COLOURS[i]}`;
    keepKeys(button);
    return button;
  });
  squares.below.append(...buttons, line, says);
  const press = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    event.stopPropagation();
    const number = Number(event.key);
    if (event.code === "Space") choose(suggested);
    else if (number >= 1 && number <= robots) choose(number);
    else return;
    event.preventDefault();
  };
  root.addEventListener("keydown", press, { signal });

  return {
    moving: ["robots", "force"],
    command: () => [...squares.stick.read(), choice],
    heard(newest) {
      suggested = newest.suggested;
      const goals = config.goals.length,
        values = { robot: newest.leader, goal: Math.min(newest.reached + 1, goals), goals },
        seconds = newest.wait.toFixed(0),
        left = newest.wait > 0.05 ? filled(words.switch_in, { seconds }) : "";
      buttons.forEach((button, i) => {
        say(button, `${i + 1}: ${Math.round(100 * newest.trust[i])} %`);
        button.style.outline = newest.leader === i + 1 ? `3px solid ${COLOURS[i]}` : "";
      });
      say(line, `${filled(words.goal_of, values)} · ${filled(words.leads, values)} ${left}`);
      const rule = config.chooses ? filled(words.may_choose, { robots }) : words.rule_chooses;
      say(says, suggested ? filled(words.suggested_leader, { robot: suggested }) : rule);
    },
    draw(picture, near, newest) {
      drawField(squares.view, config, picture);
      squares.draw(squares.stick.read(), near.force, newest.k);
    },
    wait: (on) => (squares.still = on),
  };
}

export const TASKS = { ground_robot: groundRobot, teleoperation, team };
