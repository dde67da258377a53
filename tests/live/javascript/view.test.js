// What the panel says and the gauges show, without a browser. Oracle: words and poses written here.
import assert from "node:assert";
import { test } from "node:test";
import { filled } from "./page.js";
import { Gauges, Panel, reason, refusal } from "./view.js";

class Part {
  constructor() {
    this.classList = { names: new Set(), toggle: (name, on) => this.class(name, on) };
    this.dataset = {};
    this.parentElement = { clientWidth: 0 };
  }
  class(name, on) {
    this.classList.names[on ? "add" : "delete"](name);
  }
  append() {}
  setAttribute() {}
  addEventListener() {}
  getContext() {
    return {};
  }
}
globalThis.devicePixelRatio = 1;
globalThis.document = { createElement: () => new Part() };
globalThis.ResizeObserver = class {
  observe() {}
};
const signal = { addEventListener() {} };

const words = {
  manual: "MANUAL",
  autonomous: "AUTONOMOUS",
  switching_to: "Switching to {mode}.",
  suggested: "Suggested: {mode}.",
  trust_has_fallen: "TSC {tsc} at {lower}",
  trust_has_risen: "TSC {tsc} at {upper}",
  below_its_best: "P_r {p_r} of {best}",
  at_its_best: "P_r {p_r}",
  too_early: "{seconds} of {settling} s",
  by_itself: "by itself",
  only_suggested: "only suggested",
  lap: "Lap {lap} of {laps}",
};
const task = {
  scheme: 2,
  forced: 0,
  laps: 2,
  lower: 0.1,
  upper: 0.4,
  p_max: 0.42,
  first_mode: 1,
  a_T: 1,
};
const columns = ["mode", "suggested_mode", "p_r", "p_h", "r", "tsc"];
const switching = { settling: 100 };
const config = { task, switching, columns, words, sample_time: 0.1, robot: { max_speed: 0.5 } };
const changed = (change) => ({ ...config, task: { ...task, ...change } });

test("names in braces are filled in, unknown ones stay", () => {
  assert.strictEqual(filled("{a} {b} {a}", { a: 0 }), "0 {b} 0");
});

test("a suggestion says why", () => {
  const row = [1, 0, 0.3, 0.2, 0.5, 0.456];
  assert.strictEqual(reason(config, 0, row), "TSC 0.46 at 0.40");
  assert.strictEqual(reason(config, 1, row), "TSC 0.46 at 0.10");
  assert.strictEqual(reason(changed({ scheme: 3 }), 1, row), "P_r 0.30 of 0.42");
  assert.strictEqual(reason(changed({ scheme: 3 }), 0, row), "P_r 0.30");
});

test("the space bar says why it does nothing", () => {
  const forced = changed({ forced: 1 });
  assert.strictEqual(refusal(config, 305, null), "70 of 100 s");
  assert.strictEqual(refusal(config, 1000, [1, -1]), "");
  assert.strictEqual(refusal(forced, 1000, [1, -1]), "only suggested");
  assert.strictEqual(refusal(forced, 1000, [1, 1]), "only suggested");
  assert.strictEqual(refusal(forced, 1000, [1, 0]), "");
  assert.strictEqual(refusal({ ...config, schedule: [[1, 9]] }, 1000, [1, -1]), "by itself");
});

test("the panel shows mode, lap, suggestion, and an explanation until there is one", () => {
  const panel = new Panel(new Part(), config, () => {});
  panel.explain("because");
  panel.show([1, -1, 0.3, 0.2, 0.5, 0.3], 0);
  assert.strictEqual(panel.mode.textContent, "MANUAL");
  assert.strictEqual(panel.clock.textContent, "Lap 1 of 2");
  assert.strictEqual(panel.suggestion.textContent, "because");
  panel.show([1, 0, 0.3, 0.2, 0.5, 0.45], 5);
  assert.strictEqual(panel.suggestion.textContent, "Suggested: AUTONOMOUS. TSC 0.45 at 0.40");
  assert.strictEqual(panel.clock.textContent, "Lap 2 of 2");
  assert.ok(panel.suggestion.classList.names.has("now"));
  panel.explained.until = 0;
  panel.show([0, 0, 0.3, 0.2, 0.5, 0.45], 1);
  assert.strictEqual(panel.suggestion.textContent, "");
  assert.strictEqual(panel.mode.textContent, "AUTONOMOUS");
});

test("the gauge of TSC grows with what it shows, the others do not", () => {
  const gauges = new Gauges(new Part(), config, signal);
  const [p_r, , , tsc] = gauges.panels;
  assert.deepStrictEqual([tsc.low, tsc.high], [-1, 1]);
  gauges.add([1, -1, 9, 0.2, 0.5, 3.5]);
  gauges.add([1, -1, 9, 0.2, 0.5, -2.5]);
  assert.deepStrictEqual([tsc.low, tsc.high], [-2.5, 3.5]);
  assert.strictEqual(p_r.high, 0.625);
});
