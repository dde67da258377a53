// The kernel in V8 as browsers load it. Oracle: rows of numba, which the caller has written.
import assert from "node:assert";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { Physics } from "./physics.js";

const { config, commands, rows } = JSON.parse(readFileSync("drive.json", "utf8"));
const wasm = readFileSync("kernel.wasm");

test("every row has the bits of numba", async () => {
  const physics = await Physics.load(wasm, config);
  for (const [k, [v, w, mode]] of commands.entries())
    assert.deepStrictEqual(physics.tick(v, w, mode), rows[k]);
  assert.strictEqual(physics.k, commands.length);
  assert.strictEqual(physics.done, false);
});

test("a drive is done at its last sample", async () => {
  const physics = await Physics.load(wasm, { ...config, samples: 3 });
  const done = [0, 1, 2].map(() => {
    physics.tick(0.3, 0, 1);
    return physics.done;
  });
  assert.deepStrictEqual(done, [false, false, true]);
});

test("another seed drives another way", async () => {
  const physics = await Physics.load(wasm, { ...config, seed: config.seed + 1 });
  const made = commands.map(([v, w, mode]) => physics.tick(v, w, mode));
  assert.notDeepStrictEqual(made, rows);
});

test("records are packed by their layout", async () => {
  const physics = await Physics.load(wasm, config);
  assert.strictEqual(physics.get("laps"), 0);
  assert.strictEqual(physics.get("mode"), config.task.first_mode);
  assert.strictEqual(physics.room(8) % 16, 0);
});
