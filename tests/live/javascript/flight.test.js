// A flight in V8 as browsers load it. Oracle: rows and pictures of numba, which the caller has
// written.
import assert from "node:assert";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { Flight } from "./flight.js";

const { config, memory, commands, rows, pictures } = JSON.parse(
  readFileSync("flight.json", "utf8"),
);
const wasm = readFileSync("kernel.wasm");

test("every row has the bits of numba, and every picture shows the same", async () => {
  const flight = await Flight.load(wasm, config, memory);
  for (const [k, command] of commands.entries()) {
    assert.deepStrictEqual(flight.step(command), rows[k]);
    const picture = flight.picture();
    for (const [name, value] of Object.entries(pictures[k]))
      assert.deepStrictEqual(picture[name], value, `${name} of row ${k}`);
    assert.strictEqual(picture.done, k === commands.length - 1);
  }
});

test("a flight that is taken up again goes on as it was", async () => {
  const flight = await Flight.load(wasm, config, memory);
  for (const row of rows.slice(0, 20)) flight.step(row.slice(0, 3));
  assert.deepStrictEqual(flight.step(commands[20]), rows[20]);
});

test("a flight that diverges stands still and says so", async () => {
  const flight = await Flight.load(wasm, config, memory);
  const before = flight.step(commands[0]);
  flight.view.setFloat64(flight.at.whole + memory.logged[0], NaN, true);
  const after = flight.step(commands[1]);
  assert.deepStrictEqual(after.slice(3), before.slice(3));
  assert.strictEqual(flight.picture().over, config.words.diverged);
});
