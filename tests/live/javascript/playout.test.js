// Late and uneven pictures, shown evenly. Oracle: times worked out by hand.
import assert from "node:assert";
import { test } from "node:test";
import { Playout } from "./playout.js";

const picture = (k) => ({ k, x: k, yaw: Math.PI - 0.1 + 0.2 * k, name: `p${k}` });

test("pictures between two are mixed, angles the short way round, names kept", () => {
  const playout = new Playout(["x", "yaw", "gone"], 0);
  playout.add({ ...picture(0), gone: [0, 0] }, 0);
  playout.add({ ...picture(1), yaw: -Math.PI + 0.1, gone: null }, 1);
  const { x, yaw, name, gone, shown } = playout.at(1.5, 0);
  assert.deepStrictEqual([x, name, gone, shown], [0.5, "p0", [0, 0], 0.5]);
  assert.ok(Math.abs(yaw - Math.PI) < 1e-12);
  assert.strictEqual(playout.at(1.5, 5).x, 0, "before the first");
  assert.strictEqual(playout.at(1.5, 1.2).x.toFixed(3), "0.300", "as late as the camera");
});

test("the delay becomes the lateness of pictures and a period, and is not crossed at once", () => {
  const playout = new Playout(["x"], 0);
  playout.add(picture(0), 0);
  let shown = -Infinity,
    most = 0;
  for (let k = 1; k <= 200; k += 1) {
    playout.add(picture(k), k + 2.5); // two and a half periods late
    for (let part = 0; part < 4; part += 1) {
      const time = k + 2.5 + part / 4;
      playout.tick(time);
      const now = playout.at(time, 0);
      assert.ok(now.shown >= shown, "time goes on");
      most = Math.max(most, now.shown - shown === Infinity ? 0 : now.shown - shown);
      shown = now.shown;
      assert.ok(now.shown <= k + 1e-9, "no picture is skipped");
    }
  }
  assert.ok(Math.abs(playout.delay - 3.5) < 0.05, `${playout.delay}`);
  assert.ok(most < 0.35, `${most}`);
});

test("an outage says nothing about the connection", () => {
  const playout = new Playout(["x"], 0);
  for (let k = 0; k < 50; k += 1) {
    playout.add(picture(k), k + 0.2);
    playout.tick(k + 0.2);
  }
  const before = playout.needed;
  playout.still = 55;
  for (let k = 50; k <= 55; k += 1) playout.add(picture(k), k + 40);
  assert.strictEqual(playout.needed, before);
});
