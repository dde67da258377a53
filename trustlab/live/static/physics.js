// The physics of a drive: the kernel in WebAssembly, a sample at a time.

// The kernel: numba's tick in WebAssembly, its records in memory by the layout that the
// configuration states.
export class Physics {
  static async load(wasm, config) {
    const { instance } = await WebAssembly.instantiate(wasm, {});
    return new Physics(instance.exports, config);
  }

  constructor(exports, config) {
    this.exports = exports;
    this.config = config;
    const posts = config.posts.length,
      records = config.records;
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
      pack("task", config.task),
      pack("robot", config.robot),
      numbers(config.path.flat()),
      config.path.length,
      numbers(config.posts.flat()),
      posts,
    ];
    const source = pack("source", { seed: config.seed, drawn: 0 });
    const room = [
      this.room(8 * config.samples),
      this.room(8 * config.samples),
      this.room(32 * posts),
    ];
    this.at = {
      state: this.room(records.state.size),
      forcing: this.room(records.forcing.size),
      row: this.room(records.row.size),
    };
    this.arguments = [...world, source, ...room, this.at.state, this.at.forcing, this.at.row];
    this.k = 0;
    exports.begin(this.status, this.status + 16, ...world, this.at.state, this.at.forcing);
  }

  room(bytes) {
    const at = (this.top + 15) & ~15;
    this.top = at + bytes;
    return at;
  }

  // Drive for one sample; return its row, an array in the order of the columns. `this.done` says
  // whether all laps are done.
  tick(v, w, wanted) {
    if (
      this.exports.tick(this.status, this.status + 16, this.k, v, w, wanted, ...this.arguments) !==
      0
    )
      throw new Error("the kernel failed");
    this.k += 1;
    this.done = this.memory.getInt32(this.status, true) === 1 || this.k >= this.config.samples;
    return this.config.columns.map((_, i) => this.memory.getFloat64(this.at.row + 8 * i, true));
  }

  get(name) {
    const [offset, kind] = this.config.records.state.fields[name];
    return kind === "i"
      ? Number(this.memory.getBigInt64(this.at.state + offset, true))
      : this.memory.getFloat64(this.at.state + offset, true);
  }
}
