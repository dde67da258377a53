// A team in V8 as browsers load it. Oracle: rows and pictures of `TeamLoop`, which the caller has
// written.
import assert from "node:assert";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { Lead } from "./lead.js";

const { config, memory, commands, rows, pictures } = JSON.parse(readFileSync("lead.json", "utf8"));
const wasm = readFileSync("kernel.wasm");

// JSON has one zero, doubles have two.
const plain = (value) => JSON.parse(JSON.stringify(value));

test("every row has the bits of numba, and every picture shows the same", async () => {
  const lead = await Lead.load(wasm, config, memory);
  for (const [k, command] of commands.entries()) {
    assert.deepStrictEqual(plain(lead.step(command)), plain(rows[k]));
    const { k: done, done: over, ...picture } = lead.picture();
    assert.deepStrictEqual(plain(picture), plain(pictures[k]), `picture of row ${k}`);
    assert.strictEqual(done, k + 1);
    assert.strictEqual(over, k === commands.length - 1);
  }
});

test("a run that is taken up again goes on as it was", async () => {
  const lead = await Lead.load(wasm, config, memory);
  for (const row of rows.slice(0, 250)) lead.step(row.slice(0, 3));
  assert.deepStrictEqual(plain(lead.step(commands[250])), plain(rows[250]));
});

test("a team that diverges says so", async () => {
  const lead = await Lead.load(wasm, config, memory);
  lead.step(commands[0]);
  lead.view.setFloat64(lead.at.q, NaN, true);
  assert.throws(() => lead.step(commands[1]), /diverged/);
});
