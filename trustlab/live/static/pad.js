// A hand's square and what it steers, drawn: for flights in a notebook, and for the tasks that a
// server computes.
import { clamp, gamepad, stick, stroke } from "./page.js";

export const PAD_STYLE = `
.tl-track {
  position: relative; display: grid; grid-template-columns: 1fr 1fr; gap: .5em; max-width: 60em;
  font: 15px/1.4 system-ui, sans-serif; color: #1b2430; background: #fff; padding: .4em;
  border-radius: 6px; user-select: none; }
.tl-track canvas { width: 100%; display: block; border-radius: 4px; background: #f1f4f7; }
.tl-track .pad { touch-action: none; cursor: crosshair; }
.tl-track .below {
  grid-column: 1 / -1; display: flex; flex-wrap: wrap; gap: 1em; align-items: baseline;
  font-variant-numeric: tabular-nums;
}
.tl-track .hint { grid-column: 1 / -1; font-size: .85em; color: #47525e; }
.tl-track button { font: inherit; padding: .3em .6em; }
`;

export const SIZE = 480,
  MIDDLE = SIZE / 2;
const INNER = 0.7 * MIDDLE,
  ARROW = 70; // half the hand's square, within room for the longest arrow

// Where the hand is, in [−1, 1] on both axes; whichever of pointer and stick was used last. A hand
// that lets go is in the middle.
export class Stick {
  constructor(pad, signal) {
    this.pointer = [0, 0];
    this.source = "pointer";
    const move = (event) => {
      const box = pad.getBoundingClientRect();
      const place = [
        (2 * (event.clientX - box.left)) / box.width - 1,
        1 - (2 * (event.clientY - box.top)) / box.height,
      ];
      this.pointer = place.map((x) => clamp((x * MIDDLE) / INNER, -1, 1));
      this.source = "pointer";
    };
    const release = () => (this.pointer = [0, 0]);
    for (const type of ["pointerdown", "pointermove"]) pad.addEventListener(type, move, { signal });
    for (const type of ["pointerleave", "pointercancel"])
      pad.addEventListener(type, release, { signal });
    const lift = ({ pointerType }) => pointerType !== "mouse" && release();
    pad.addEventListener("pointerup", lift, { signal });
  }

  read() {
    const place = stick(gamepad());
    if (place[0] || place[1]) this.source = "gamepad";
    return this.source === "gamepad" ? place : this.pointer;
  }

  // The vibration cue: as strong as the force is large, without a direction.
  rumble(share) {
    const effect = { duration: 120, strongMagnitude: share, weakMagnitude: share };
    gamepad()
      ?.vibrationActuator?.playEffect?.("dual-rumble", effect)
      ?.catch(() => {});
  }
}

export function dot(g, [x, y], radius, colour) {
  g.fillStyle = colour;
  g.beginPath();
  g.arc(x, y, radius, 0, 2 * Math.PI);
  g.fill();
}

export function arrow(g, [x, y], [dx, dy], colour) {
  const long = Math.hypot(dx, dy);
  if (long < 3) return;
  const [ux, uy] = [dx / long, dy / long],
    head = Math.min(14, long);
  stroke(g, colour, 4, [x, y], [x + dx - head * ux, y + dy - head * uy]);
  g.fillStyle = colour;
  g.beginPath();
  g.moveTo(x + dx, y + dy);
  g.lineTo(x + dx - head * (ux - 0.6 * uy), y + dy - head * (uy + 0.6 * ux));
  g.lineTo(x + dx - head * (ux + 0.6 * uy), y + dy - head * (uy - 0.6 * ux));
  g.fill();
}

function spring(g, [x, y], [toX, toY]) {
  const turns = 14,
    dx = toX - x,
    dy = toY - y,
    long = Math.hypot(dx, dy) || 1;
  const turn = (_, i) => {
    const aside = i % turns ? (i % 2 ? 6 : -6) : 0;
    return [x + (dx * i) / turns - (aside * dy) / long, y + (dy * i) / turns + (aside * dx) / long];
  };
  stroke(g, "#6b7683", 2, ...Array.from({ length: turns + 1 }, turn));
}

// What the camera under the UAV shows, from above: the floor's grid, the UAV in the middle, the
// target.
export function drawPicture(g, config, now) {
  const scale = MIDDLE / config.half,
    step = config.half / 3;
  g.clearRect(0, 0, SIZE, SIZE);
  for (let i = -4; i <= 4; i += 1) {
    const x = MIDDLE + scale * (i * step - (now.robot[0] % step)),
      y = MIDDLE - scale * (i * step - (now.robot[1] % step));
    stroke(g, "#cdd5dd", 1, [x, 0], [x, SIZE]);
    stroke(g, "#cdd5dd", 1, [0, y], [SIZE, y]);
  }
  stroke(g, "#0072b2", 3, [MIDDLE - 14, MIDDLE], [MIDDLE + 14, MIDDLE]);
  stroke(g, "#0072b2", 3, [MIDDLE, MIDDLE - 14], [MIDDLE, MIDDLE + 14]);
  g.font = "18px system-ui, sans-serif";
  g.fillStyle = "#1b2430";
  if (!now.target) return g.fillText("The target is out of the picture", 12, 26);
  const [x, y] = now.target,
    most = Math.max(Math.abs(x), Math.abs(y)) / config.half;
  if (most <= 1) return dot(g, [MIDDLE + scale * x, MIDDLE - scale * y], 12, "#a04800");
  const edge = (0.92 * MIDDLE) / (most * config.half); // a target beyond the drawing: where to
  arrow(
    g,
    [MIDDLE + 0.8 * edge * x, MIDDLE - 0.8 * edge * y],
    [0.2 * edge * x, -0.2 * edge * y],
    "#a04800",
  );
}

// The hand's square: hand, device, the spring between them, and the guiding force that the device
// would give: visual cues.
export function drawPad(g, hand, now, largest) {
  const place = ([x, y]) => [MIDDLE + INNER * x, MIDDLE - INNER * y];
  g.clearRect(0, 0, SIZE, SIZE);
  g.strokeStyle = "#cdd5dd";
  g.lineWidth = 2;
  g.strokeRect(MIDDLE - INNER, MIDDLE - INNER, 2 * INNER, 2 * INNER);
  dot(g, [MIDDLE, MIDDLE], 3, "#cdd5dd");
  spring(g, place(hand), place(now.device));
  dot(g, place(now.device), 11, "#0072b2");
  dot(g, place(hand), 7, "#1b2430");
  arrow(
    g,
    place(now.device),
    [(ARROW * now.guide[0]) / largest, (-ARROW * now.guide[1]) / largest],
    "#00784f",
  );
}
