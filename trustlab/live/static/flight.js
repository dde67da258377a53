// The physics of a flight: the teleoperation loop in WebAssembly, a period at a time. `memory` says
// where in its arrays stands what is logged and shown.
import { Computed } from "./computed.js";

export class Flight extends Computed {
  constructor(exports, config, memory) {
    super(exports, config, memory);
    // The loop calls its parts by their places in a table of functions.
    const table = exports.__indirect_function_table;
    for (const { part, offset } of memory.parts) {
      const place = table.grow(1);
      table.set(place, exports[part]);
      this.view.setBigInt64(this.at.setups + offset, BigInt(place), true);
    }
    this.failed = false;
    this.values = memory.logged.map(() => 0);
  }

  // Fly a period under a command; return its row. A flight that diverged stands still.
  step(command) {
    const { logged } = this.plan;
    if (!this.failed) this.failed = this.period("fly", command) !== -1;
    if (!this.failed) this.values = logged.map((offset) => this.number("states", offset));
    this.k += 1;
    return [...command, ...this.values];
  }

  // What the page draws: the camera's picture as late as it arrives, the device, and forces.
  picture() {
    const { every, late, input, past, shown, reach, scaling } = this.plan,
      k = this.k * every - 1 - late,
      t = this.k * this.config.sample_time,
      about = { k: this.k, t, done: this.k >= this.config.samples };
    if (this.failed) return { ...about, over: this.config.words.diverged };
    const error = k < 0 ? [0, 0] : this.pair("history", k * past.size + past.error),
      reference = k < 0 ? [0, 0] : this.pair("inputs", k * input.size + input.reference),
      [device, force, guide] = shown.map((offset) => this.pair("states", offset));
    return {
      ...about,
      target: error.every((x) => Math.abs(x) <= this.plan.view) ? error : null,
      robot: reference.map((x, i) => x - error[i]),
      device: device.map((x, i) => x / reach[i]),
      force: force.map((x) => -scaling * x),
      guide: guide.map((x) => -scaling * x),
    };
  }
}
