// A run that the page computes: the arrays of its loop in the memory of the compiled kernel.
//
// `memory` has the arrays by name, with what the study's server has drawn for this run, and the
// names of those whose addresses the kernel is given.

const STATUS = 32; // bytes for what the compiled function returns

function bytes(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

export class Computed {
  static async load(wasm, config, memory) {
    const { instance } = await WebAssembly.instantiate(wasm, {});
    return new this(instance.exports, config, memory);
  }

  constructor(exports, config, memory) {
    Object.assign(this, { exports, config, plan: memory, k: 0 }); // k: periods
    this.status = (exports.__heap_base.value + 64) & ~15;
    const addresses = { name: "addresses", size: 8 * memory.addresses.length },
      arrays = [...memory.arrays, addresses],
      size = arrays.reduce((sum, { size }) => sum + size + 16, STATUS);
    exports.memory.grow(Math.ceil(size / 65_536) + 1);
    this.view = new DataView(exports.memory.buffer);
    this.at = {};
    let top = this.status + STATUS;
    for (const { name, size, data } of arrays) {
      this.at[name] = top;
      if (data) new Uint8Array(exports.memory.buffer).set(bytes(data), top);
      top = (top + size + 15) & ~15;
    }
    memory.addresses.forEach((name, i) =>
      this.view.setBigInt64(this.at.addresses + 8 * i, BigInt(this.at[name]), true),
    );
  }

  // Compute a period; return how it ended, -1 for well.
  period(entry, command) {
    const first = BigInt(this.k * this.plan.every),
      stop = first + BigInt(this.plan.every),
      [value, error, compiled] = [this.status, this.status + 16, this.exports[entry]],
      fault = compiled(value, error, first, stop, ...command, this.at.addresses);
    if (fault) throw new Error("the kernel failed");
    return this.view.getInt32(this.status, true);
  }

  number(array, offset) {
    return this.view.getFloat64(this.at[array] + offset, true);
  }

  pair(array, offset) {
    return [this.number(array, offset), this.number(array, offset + 8)];
  }
}
