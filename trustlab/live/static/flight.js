// The physics of a flight: the teleoperation loop in WebAssembly, a period at a time. `memory` says
// where in its arrays stands what is logged and shown.
import { Computed } from "./computed.js";

export class Flight extends Computed {
  constructor(exports, config, memory) {
    super(exports, config, memory);
    this.failed = false;
    this.values = memory.logged.map(() => 0);
  }

  // Fly a period under a command; return its row. A flight that diverged stands still.
  step(command) {
    const { logged, row, every } = this.plan;
    if (!this.failed) this.failed = this.period("fly", command) !== -1;
    this.k += 1;
    const last = (this.k * every - 1) * row;
    if (!this.failed) this.values = logged.map((offset) => this.number("log", last + offset));
    return [...command, ...this.values];
  }

  // What the page draws: the camera's picture as late as it arrives, the device, and forces.
  picture() {
    const { every, late, row, seen, shown, reach, scaling } = this.plan,
      k = this.k * every - 1,
      t = this.k * this.config.sample_time,
      about = { k: this.k, t, done: this.k >= this.config.samples },
      at = (k, offset) => (k < 0 ? [0, 0] : this.pair("log", k * row + offset));
    if (this.failed) return { ...about, over: this.config.words.diverged };
    const [error, robot] = seen.map((offset) => at(k - late, offset)),
      [device, force, guide] = shown.map((offset) => at(k, offset));
    return {
      ...about,
      target: error.every((x) => Math.abs(x) <= this.plan.view) ? error : null,
      robot,
      device: device.map((x, i) => x / reach[i]),
      force: force.map((x) => -scaling * x),
      guide: guide.map((x) => -scaling * x),
    };
  }
}
