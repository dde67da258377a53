// Hands at keys, gamepad and pointer, without a browser. Oracle: ramps worked out by hand.
import assert from "node:assert";
import { beforeEach, test } from "node:test";
import { Hands } from "./hands.js";

const RAMP = { rise: 2.5, fall: 6 };
let pads, root, blurred, hands;

class Root extends EventTarget {
  dataset = {};
  focus() {}
  contains(element) {
    return element === "own button";
  }
}

function send(target, type, facts = {}) {
  const event = Object.assign(new Event(type, { cancelable: true }), facts);
  target.dispatchEvent(event);
  return event;
}

beforeEach(() => {
  pads = [];
  root = new Root();
  blurred = 0;
  globalThis.window = new EventTarget();
  const value = { getGamepads: () => pads };
  Object.defineProperty(globalThis, "navigator", { value, configurable: true });
  hands = new Hands(root, RAMP, () => (blurred += 1), new AbortController().signal);
});

const near = (made, expected) =>
  made.forEach((x, i) => assert.ok(Math.abs(x - expected[i]) < 1e-12, `${made} for ${expected}`));

test("keys move levers by their ramps", () => {
  send(root, "keydown", { code: "ArrowUp" });
  near(hands.read(0.1), [0.25, 0]);
  near(hands.read(0.1), [0.5, 0]);
  for (let n = 0; n < 5; n += 1) hands.read(0.1);
  near(hands.read(0.1), [1, 0]);
  send(root, "keyup", { code: "ArrowUp" });
  near(hands.read(0.1), [0.4, 0]);
  near(hands.read(0.1), [0, 0]);
});

test("opposite keys cancel, and letters are arrows", () => {
  for (const code of ["KeyA", "ArrowRight", "KeyW"]) send(root, "keydown", { code });
  near(hands.read(0.4), [1, 0]);
});

test("the space bar counts once however long it is held", () => {
  const first = send(root, "keydown", { code: "Space" });
  send(root, "keydown", { code: "Space", repeat: true });
  assert.strictEqual(hands.toggles, 1);
  assert.ok(first.defaultPrevented, "the page does not scroll");
});

test("shortcuts of the browser are not touched", () => {
  const event = send(root, "keydown", { code: "KeyW", ctrlKey: true });
  assert.ok(!event.defaultPrevented);
  near(hands.read(0.1), [0, 0]);
  assert.strictEqual(root.dataset.lmSuppressShortcuts, "true");
});

test("who looks elsewhere lets go", () => {
  send(root, "keydown", { code: "KeyW" });
  hands.read(0.2);
  send(root, "blur", { relatedTarget: "own button" });
  assert.strictEqual(blurred, 0);
  send(root, "blur");
  near(hands.read(0.1), [0, 0]);
  assert.strictEqual(blurred, 1);
});

test("a stick is read as it is, but for its play", () => {
  const pad = { connected: true, axes: [0.05, -0.07], buttons: [{ pressed: false }] };
  pads = [null, pad];
  near(hands.read(0.1), [0, 0]);
  pad.axes = [0.5, -0.75];
  near(hands.read(0.1), [0.75, -0.5]);
  assert.strictEqual(hands.source, "gamepad");
  pad.buttons[0].pressed = true;
  hands.read(0.1);
  hands.read(0.1);
  assert.strictEqual(hands.toggles, 1);
});

test("a dragging pointer is a stick of 80 pixels", () => {
  const target = { closest: () => null };
  const down = { pointerId: 1, clientX: 100, clientY: 100 };
  const event = new Event("pointerdown");
  Object.defineProperty(event, "target", { value: target });
  root.dispatchEvent(Object.assign(event, down));
  send(globalThis.window, "pointermove", { pointerId: 2, clientX: 0, clientY: 0 });
  near(hands.read(0.1), [0, 0]);
  send(globalThis.window, "pointermove", { pointerId: 1, clientX: 140, clientY: 0 });
  near(hands.read(0.1), [1, -0.5]);
  send(globalThis.window, "pointerup", { pointerId: 1 });
  near(hands.read(0.1), [0, 0]);
});
