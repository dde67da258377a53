// A drive of the ground robot: physics at 10 Hz, hands, and a view, on one clock.
//
// drive(root, config, wasm, on): config is made by trustlab.live.runs.drive_config;
// `on` has row(k, values), note(text), end(summary).
// Nothing here knows where rows go.
import { Hands, script } from "./hands.js";
import { Physics } from "./physics.js";
import { furnish, refusal } from "./view.js";

function wanting(config) {
  const ends = [];
  for (const [mode, seconds] of config.schedule ?? [])
    ends.push([mode, (ends.at(-1)?.[1] ?? 0) + seconds]);
  return (k) => (ends.find(([, end]) => k * config.sample_time < end) ?? ends.at(-1))?.[0] ?? null;
}

export async function drive(root, config, wasm, on) {
  const physics = await Physics.load(wasm, config),
    dt = (1000 * config.sample_time) / (config.pace ?? 1),
    scheduled = wanting(config);
  let wanted = config.task.first_mode,
    row = null,
    running = true,
    paused = null,
    last = performance.now(),
    behind = 0,
    timer = 0;
  const frames = [],
    stamps = [];
  const hands = new Hands(root, config.ramp, () => running && on.note("focus lost: keys released"));
  const hand = config.hand ? script(config.hand, config, physics) : null,
    leaving = new AbortController();
  const { camera, gauges, panel, away } = furnish(
    root,
    config,
    () => {
      hands.toggles += 1;
    },
    leaving.signal,
  );
  let shown = null;

  function take(v, w) {
    row = physics.tick(v, w, scheduled(physics.k) ?? wanted);
    // A wish is not kept where it cannot be met now: before the window is full, or without the
    // suggestion that must be followed.
    if (config.task.forced || physics.k * config.sample_time <= config.task.settling)
      wanted = row[0];
    camera.add({ k: physics.k, x: physics.get("x"), y: physics.get("y"), yaw: physics.get("yaw") });
    gauges.add(row);
    return row;
  }

  function sample() {
    const scripted = hand?.(physics.k, row),
      [forward, left] = scripted
        ? [scripted.forward, scripted.left]
        : hands.read(config.sample_time);
    if (hands.toggles % 2) {
      const words = refusal(config, physics.k, row);
      if (words) panel.explain(words);
      else wanted = 1 - (row?.[0] ?? wanted);
    }
    hands.toggles = 0;
    if (scripted && scripted.wanted !== null) wanted = scripted.wanted;
    const k = physics.k;
    take(Math.max(forward, 0) * config.robot.max_speed, left * config.robot.max_turn_rate);
    stamps.push(performance.now());
    on.row(k, row);
    if (physics.done) finish("complete");
  }

  function finish(why) {
    if (!running) return;
    stop();
    draw();
    on.end({ rows: physics.k, laps: physics.get("laps"), why });
  }

  function stop() {
    running = false;
    clearInterval(timer);
    hands.stop.abort();
    leaving.abort();
  }

  function draw() {
    camera.draw(physics.k + behind / dt);
    gauges.draw();
    if (row !== shown) panel.show((shown = row), physics.get("laps"));
  }

  // Samples that are due by the clock. A gap, in which the page slept, is a pause of the robot, and
  // is logged as one.
  function advance() {
    const now = performance.now(),
      gap = now - last;
    last = now;
    if (!running || paused !== null) return;
    if (gap > 250) {
      on.note(`pause of ${(gap / 1000).toFixed(2)} s: the page did not run`);
      return;
    }
    behind += gap;
    while (running && behind >= dt) {
      behind -= dt;
      sample();
    }
  }

  function pause(why = "paused") {
    if (!running || paused !== null) return;
    paused = performance.now();
    hands.clear();
    away.hidden = false;
    on.note(`pause begins: ${why}`);
  }

  function resume() {
    if (paused === null) return;
    on.note(`pause ends after ${((performance.now() - paused) / 1000).toFixed(2)} s`);
    [paused, last, behind, away.hidden] = [null, performance.now(), 0, true];
    root.focus({ preventScroll: true });
  }

  function frame(now) {
    if (!running) return;
    frames.push(now);
    if (frames.length > 600) frames.shift();
    advance();
    if (running) draw();
    requestAnimationFrame(frame);
  }

  // Go on behind rows that were driven before: the same commands give the same rows.
  function resume_from(rows) {
    const at = ["v_command", "w_command", "mode"].map((name) => config.columns.indexOf(name));
    for (const earlier of rows) {
      wanted = earlier[at[2]];
      take(earlier[at[0]], earlier[at[1]]);
    }
    if (physics.done) finish("complete");
  }

  // How the page keeps up: frames a second, the log's period [s], and what the hands are on.
  function telemetry() {
    const periods = stamps
      .slice(1)
      .map((x, i) => x - stamps[i])
      .sort((a, b) => a - b);
    const fps = frames.length > 1 ? (1000 * (frames.length - 1)) / (frames.at(-1) - frames[0]) : 0;
    return {
      fps,
      rows: physics.k,
      source: hands.source,
      period_median: (periods[periods.length >> 1] ?? 0) / 1000,
      period_max: (periods.at(-1) ?? 0) / 1000,
    };
  }

  away.addEventListener(
    "click",
    () => {
      if (!document.hidden) resume();
    },
    { signal: leaving.signal },
  );
  document.addEventListener(
    "visibilitychange",
    () => (document.hidden ? pause("the page is hidden") : resume()),
    { signal: leaving.signal },
  );
  if (config.rows?.length) resume_from(config.rows);
  const rush = () => {
    // tests and rehearsals: as fast as the kernel goes
    for (let n = 0; running && paused === null && n < 200; n += 1) sample();
    if (running) setTimeout(rush, 0);
  };
  if (running && config.clock === "accelerated") setTimeout(rush, 0);
  else if (running) {
    timer = setInterval(advance, 40); // beside frames, which a busy machine may hold back
    requestAnimationFrame(frame);
  }
  return {
    stop,
    pause,
    resume,
    resume_from,
    telemetry,
    physics,
    hands,
    get row() {
      return row;
    },
  };
}
