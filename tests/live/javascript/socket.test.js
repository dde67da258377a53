// A connection that comes back by itself, over channels made here. Oracle: what each channel heard.
import assert from "node:assert";
import { mock, test } from "node:test";
import { connect } from "./socket.js";

function harness() {
  const channels = [],
    heard = [],
    down = [];
  const open = () => {
    const channel = { readyState: 0, sent: [], closed: false };
    channel.send = (text) => channel.sent.push(JSON.parse(text));
    channel.close = () => (channel.closed = true);
    channels.push(channel);
    return channel;
  };
  const link = connect(open, {
    hello: () => ({ begin: true }),
    heard: (answer) => heard.push(answer),
    down: (why) => down.push(why),
  });
  const up = () => {
    channels.at(-1).readyState = 1;
    channels.at(-1).onopen();
  };
  const answer = (value) => channels.at(-1).onmessage({ data: JSON.stringify(value) });
  return { link, channels, heard, down, up, answer };
}

test("it greets, hears, and after a close or a silence tries anew", () => {
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  let now = 0;
  mock.method(performance, "now", () => now);
  const tick = (ms) => {
    for (let t = 0; t < ms; t += 50) {
      now += 50;
      mock.timers.tick(50);
    }
  };
  const { link, channels, heard, down, up, answer } = harness();
  link.send({ lost: 1 }); // nobody hears it yet
  up();
  assert.deepStrictEqual(channels[0].sent, [{ begin: true }]);
  answer({ k: 0 });
  link.send({ k: 0 });
  answer({ k: 1 });
  assert.deepStrictEqual(heard, [{ k: 0 }, { k: 1 }]);
  tick(5000); // nothing is due
  assert.strictEqual(channels.length, 1);
  link.send({ k: 1 });
  tick(2000); // an answer is due
  assert.ok(channels[0].closed);
  assert.strictEqual(channels.length, 2);
  up();
  channels[1].onclose({ reason: "gone" });
  tick(400);
  assert.strictEqual(channels.length, 3);
  up();
  answer({ trouble: "the disk is full" });
  tick(800);
  assert.deepStrictEqual(down, ["", "gone", "the disk is full"]);
  assert.strictEqual(channels.length, 4);
  link.stop();
  tick(5000);
  assert.strictEqual(channels.length, 4);
  mock.timers.reset();
  mock.restoreAll();
});
