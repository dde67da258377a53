// A run over channels made here, with a task of its own. Oracle: what the page sent and was told.
import assert from "node:assert";
import { test } from "node:test";
import { play } from "./play.js";
import { TASKS } from "./tasks.js";

globalThis.document = { addEventListener() {}, hidden: true };
globalThis.requestAnimationFrame = () => {};
const drawn = [];
TASKS.none = () => ({
  moving: ["x"],
  heard() {},
  command: () => [0],
  wait() {},
  draw: ({ x }) => drawn.push(x),
});

function driving(t) {
  const channels = [],
    ends = [];
  const open = () => {
    channels.push({ readyState: 1, sent: 0, close() {}, send: () => (channels.at(-1).sent += 1) });
    return channels.at(-1);
  };
  const run = play({}, open, { heard() {}, say() {}, end: (words) => ends.push(words) });
  t.after(() => run.stop(""));
  const begun = (attempt, k) => {
    const drive = { live_task: "none", sample_time: 0.05, samples: 99, late: 0 },
      config = { ...drive, words: {}, attempt },
      answer = { k, done: false, picture: { x: 0 }, config };
    channels.at(-1).onopen();
    channels.at(-1).onmessage({ data: JSON.stringify(answer) });
  };
  return { channels, ends, run, begun };
}

test("a drive that was begun again while the connection was down is not continued", async (t) => {
  const { channels, ends, run, begun } = driving(t);
  const again = async () => {
    const before = channels.length;
    channels.at(-1).onclose({ reason: "" });
    while (channels.length === before) await new Promise((ok) => setTimeout(ok, 20));
  };
  begun(0, 0);
  await again();
  begun(0, 0);
  assert.deepStrictEqual(ends, []);
  await again();
  begun(1, 0);
  assert.deepStrictEqual(ends, [""]);
  assert.ok(run.state().over);
});

test("a page whose commands cannot be stops, says why, and sends no more", async (t) => {
  const { channels, ends, run, begun } = driving(t);
  document.hidden = false;
  begun(0, 0);
  while (channels[0].sent < 3) await new Promise((ok) => setTimeout(ok, 20));
  channels[0].onmessage({ data: JSON.stringify({ refused: "mode cannot be 7" }) });
  assert.deepStrictEqual(ends, ["mode cannot be 7"]);
  const { sent } = channels[0];
  await new Promise((ok) => setTimeout(ok, 200));
  assert.deepStrictEqual([channels.length, channels[0].sent], [1, sent]);
  assert.ok(run.state().over);
});

test("every frame shows a little more than the one before", (t) => {
  let now = 0,
    k = 0,
    frame;
  t.mock.method(performance, "now", () => now);
  t.mock.method(globalThis, "requestAnimationFrame", (next) => (frame = next));
  document.hidden = false;
  const { channels, begun } = driving(t);
  begun(0, k);
  for (let n = 0; n < 120; n += 1) {
    const { sent } = channels[0];
    now += 16;
    frame(now);
    if (channels[0].sent === sent) continue;
    k += 1; // a picture of each period, 50 ms
    channels[0].onmessage({ data: JSON.stringify({ k, done: false, picture: { x: k } }) });
  }
  assert.strictEqual(drawn.length, 120);
  assert.strictEqual(k, 38);
  const steps = drawn.slice(1).map((x, i) => x - drawn[i]);
  assert.ok(steps.slice(10).every((step) => step > 0 && step < 0.5), `${steps}`);
});
