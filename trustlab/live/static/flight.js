// The physics of a flight: the teleoperation loop in WebAssembly, a period at a time.
//
// `memory` says which arrays the loop has, with what the study's server has drawn for this flight,
// and where in them stands what is logged and shown.

const STATUS = 32; // bytes for what the compiled function returns

function bytes(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

export class Flight {
  static async load(wasm, config, memory) {
    const { instance } = await WebAssembly.instantiate(wasm, {});
    return new Flight(instance.exports, config, memory);
  }

  constructor(exports, config, memory) {
    this.exports = exports;
    this.config = config;
    this.plan = memory;
    const start = (exports.__heap_base.value + 64) & ~15,
      size = memory.arrays.reduce((sum, { size }) => sum + size + 16, STATUS);
    exports.memory.grow(Math.ceil(size / 65_536) + 1);
    this.view = new DataView(exports.memory.buffer);
    this.at = {};
    let top = start + STATUS;
    for (const { name, size, data } of memory.arrays) {
      this.at[name] = top;
      if (data) new Uint8Array(exports.memory.buffer).set(bytes(data), top);
      top = (top + size + 15) & ~15;
    }
    // The loop calls its parts by their places in a table of functions.
    const table = exports.__indirect_function_table;
    for (const { part, offset } of memory.parts) {
      const place = table.grow(1);
      table.set(place, exports[part]);
      this.view.setBigInt64(this.at.setups + offset, BigInt(place), true);
    }
    // as fly_there takes them: the log's row is the beginning of the state
    const first = ["hand", "setups", "states", "states", "inputs", "delays", "arrives", "accounts"];
    this.arguments = [...first, "history", "sent", "table", "table"].map((name) => this.at[name]);
    this.status = start;
    this.k = 0; // periods
    this.failed = false;
    this.values = memory.logged.map(() => 0);
  }

  number(array, offset) {
    return this.view.getFloat64(this.at[array] + offset, true);
  }

  pair(array, offset) {
    return [this.number(array, offset), this.number(array, offset + 8)];
  }

  // Fly a period under a command; return its row. A flight that diverged stands still.
  step([x, y, choice]) {
    const { every, samples, logged } = this.plan,
      first = BigInt(this.k * every),
      stop = first + BigInt(every),
      command = [first, stop, x, y, choice, BigInt(samples)];
    if (!this.failed) {
      const fault = this.exports.fly(this.status, this.status + 16, ...command, ...this.arguments);
      if (fault) throw new Error("the kernel failed");
      this.failed = this.view.getInt32(this.status, true) !== -1;
    }
    if (!this.failed) this.values = logged.map((offset) => this.number("states", offset));
    this.k += 1;
    return [x, y, choice, ...this.values];
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
