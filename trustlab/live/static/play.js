// A run of a task: commands by the clock, pictures by the screen.
//
// play(root, open, on): `open` as for connect; `on` has heard(answer), say(words) for trouble, and
// end(words), words of why the run cannot go on here, or "" where it is over.
import { Playout } from "./playout.js";
import { connect } from "./socket.js";
import { TASKS } from "./tasks.js";

const AHEAD = 500, // [ms] of commands that may be unanswered; then the task stands still
  ASLEEP = 250; // [ms] a page that did not run for longer makes no commands for that time

export function play(root, open, on) {
  const tab = crypto.getRandomValues(new Uint32Array(3)).join("-"), // one window drives at a time
    leaving = new AbortController(),
    waiting = [], // commands without an answer
    frames = [];
  let config = null,
    task = null,
    playout = null,
    newest = null,
    dt = 0,
    have = 0, // commands that were done: `waiting` begins with command number `have`
    behind = 0, // [ms] since the last command
    last = 0,
    seen = 0, // the time of the picture on the screen
    still = false,
    over = false;

  const made = () => have + waiting.length,
    time = () => made() + Math.min(behind / dt, 1),
    note = (words) => link.send({ window: tab, note: words });

  function send(commands, k) {
    link.send({ window: tab, k, commands, seen: Math.round(100 * seen) / 100 });
  }

  function begin(answer) {
    config = answer.config;
    dt = 1000 * config.sample_time;
    have = answer.k;
    task = TASKS[config.live_task](root, config, leaving.signal, note);
    playout = new Playout(task.moving, have);
    last = performance.now();
    requestAnimationFrame(frame);
  }

  function heard(answer) {
    if (over) return;
    if (answer.refused) return stop(answer.refused);
    if (answer.other_window) return stop(config.words.other_window);
    if (answer.k === undefined) return stop(""); // over, or begun again elsewhere
    if (!task) begin(answer);
    else if (answer.config && answer.config.attempt !== config.attempt)
      return stop(""); // begun again while the connection was down
    on.heard(answer);
    waiting.splice(0, answer.k - have);
    const fresh = answer.k > have || !newest;
    have = answer.k;
    if (fresh) {
      newest = { k: have, ...answer.picture };
      if (!newest.over) playout.add(newest, time());
      task.heard(newest);
    }
    on.say(newest.over ?? "");
    if (answer.done) stop("");
    else if (answer.config && waiting.length) send(waiting, have); // they are not there yet
  }

  const mayGo = () => waiting.length * dt < AHEAD && made() < config.samples;

  function command() {
    waiting.push(task.command(newest));
    send(waiting.slice(-1), made() - 1);
  }

  function advance() {
    const now = performance.now(),
      gap = now - last;
    last = now;
    if (over || !task || document.hidden) return;
    if (config.clock === "accelerated") {
      if (!waiting.length) command(); // as fast as it is answered: rehearsals
      return;
    }
    if (gap > ASLEEP) return note(`the page did not run for ${Math.round(gap)} ms`);
    behind += gap;
    while (behind >= dt && mayGo()) {
      behind -= dt;
      command();
    }
    still = behind >= dt;
    if (still) {
      behind = dt; // the task stands still
      playout.still = made();
    }
    task.wait(still);
  }

  function frame(now) {
    if (over) return;
    frames.push(now);
    if (frames.length > 600) frames.shift();
    advance();
    if (playout.past.length && !newest.over) {
      playout.tick(time());
      // A period's command is made at its end, so that the clock is a period ahead of the task.
      const late = (1000 * config.late) / dt + 1,
        picture = playout.at(time(), late);
      seen = picture.shown;
      task.draw(picture, playout.at(time(), 0), newest);
    }
    requestAnimationFrame(frame);
  }

  function telemetry() {
    const fps = frames.length > 1 ? (1000 * (frames.length - 1)) / (frames.at(-1) - frames[0]) : 0;
    return { fps: Math.round(fps), delay: Math.round(playout.delay * dt) };
  }

  function stop(words) {
    if (over) return;
    over = true;
    clearInterval(timer);
    leaving.abort();
    link.stop();
    on.end(words);
  }

  const link = connect(open, {
    hello: () => ({ window: tab, begin: true }),
    heard,
    down: (why) => on.say(why || (config?.words.no_connection ?? "")),
  });
  const timer = setInterval(() => task && advance(), 10),
    signal = leaving.signal,
    hide = () => note(document.hidden ? "the page is hidden" : "the page is seen again");
  document.addEventListener("visibilitychange", hide, { signal });
  return {
    stop,
    telemetry,
    state: () => ({ have, made: made(), still, over }),
  };
}
