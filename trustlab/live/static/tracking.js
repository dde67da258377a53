// The UAV that follows a target: the hand goes to the kernel, and what the kernel answers is drawn.
// No physics here. What was sent is kept in the browser until the flight is over, so that a kernel
// that was restarted can fly it again.
import { PAD_STYLE, SIZE, Stick, drawPad, drawPicture } from "./pad.js";
import { dress, element, keepKeys } from "./page.js";
import { Rows } from "./rows.js";

const EVERY = 33,
  MOST_UNANSWERED = 12;

const SILENT =
  "The kernel does not answer, and the flight waits. If the kernel was restarted, run the cell " +
  "again and start: the flight goes on where it was.";
const PATIENCE = 2000; // how long an answer may take before the page says so [ms]

function furnish(root) {
  dress(root, PAD_STYLE);
  root.className = "tl-track";
  const picture = element("canvas", { className: "picture", width: SIZE, height: SIZE }),
    pad = element("canvas", { className: "pad", width: SIZE, height: SIZE }),
    below = element("div", { className: "below" });
  picture.setAttribute("aria-label", "what the UAV's camera shows: the target as seen from above");
  pad.setAttribute(
    "aria-label",
    "the hand's square, with hand, simulated device, spring and force as visual cues",
  );
  const button = element("button", { textContent: "Start" }),
    status = element("span", { className: "status", role: "status" }),
    ledger = element("span", { className: "ledger" });
  keepKeys(button);
  below.append(button, status, ledger);
  const hint = element("div", {
    className: "hint",
    textContent:
      "Move the pointer in the right square, a finger, or a gamepad's stick: the further from " +
      "the middle, the faster the UAV flies. Keep the target (left, brown) on the cross. The " +
      "green arrow is the guiding force that the simulated device would give: a visual cue.",
  });
  root.replaceChildren(picture, pad, below, hint);
  return {
    picture: picture.getContext("2d"),
    pad,
    cues: pad.getContext("2d"),
    button,
    status,
    ledger,
  };
}

function words(now, config, largest) {
  const joule = Object.entries(now.energies)
    .map(([name, value]) => `${name} ${value.toFixed(3)}`)
    .join(", ");
  const force = `arrow ${Math.hypot(...now.guide).toFixed(2)} N (longest ${largest.toFixed(2)} N)`;
  return [
    `${now.t.toFixed(1)} of ${config.duration.toFixed(0)} s   ` +
      `α ${now.alpha.toFixed(2)}   β ${now.beta.toFixed(2)}`,
    `${force}   energies [J]: ${joule}`,
  ];
}

// A message as it is kept, a row of numbers or of a word, and back.
const row_of = ({ hand, time, pause }) => (hand ? [...hand, time] : [pause]);
const message_of = ([, , ...values]) =>
  values.length === 1 ? { pause: values[0] } : { hand: values.slice(0, 2), time: values[2] };

function render({ model, el }) {
  const config = model.get("config"),
    tab = crypto.getRandomValues(new Uint32Array(3)).join("-"), // one window flies at a time
    root = element("div"),
    leaving = new AbortController(),
    signal = leaving.signal,
    kept = new Rows(config.key, null);
  el.append(root);
  const { picture, pad, cues, button, status, ledger } = furnish(root),
    hand = new Stick(pad, signal);
  let now = null,
    running = false,
    sent = 0,
    answered = 0,
    heardAt = 0,
    timer = 0,
    count = 0, // messages of this flight, those before a restart of the kernel included
    frames = 0,
    largest = 0.1; // the arrow's scale [N] grows with the forces

  function send(message) {
    try {
      model.send({ id: ++sent, window: tab, ...message });
    } catch {
      // after a restart there is nobody to send to
    }
  }

  // Send what the flight depends on, and keep it.
  function fly(message) {
    kept.add(count++, row_of(message));
    send(message);
  }

  // With too much unanswered the kernel is busy: the page falls silent, which the kernel takes as a
  // pause.
  function tell() {
    if (!running || document.hidden) return;
    if (performance.now() - heardAt > PATIENCE) status.textContent = SILENT;
    if (sent - answered >= MOST_UNANSWERED) return;
    fly({ hand: hand.read(), time: performance.now() / 1000 });
  }

  function end(message) {
    running = false;
    button.disabled = true;
    status.textContent = message;
  }

  function heard(answer) {
    answered = Math.max(answered, answer.id ?? 0);
    heardAt = performance.now();
    if (answer.robot) {
      now = answer;
      largest = Math.max(largest, Math.hypot(...now.guide));
      [status.textContent, ledger.textContent] = words(now, config, largest);
      if (config.vibration && running) hand.rumble(Math.hypot(...now.guide) / largest);
    }
    if (answer.refused) end(answer.refused);
    if (answer.over) {
      end(answer.over);
      kept.drop();
    }
  }

  function frame() {
    if (signal.aborted) return;
    if (now) {
      drawPicture(picture, config, now);
      drawPad(cues, hand.read(), now, largest);
      root.drawn = { frames: ++frames, now };
    }
    requestAnimationFrame(frame);
  }

  async function begin() {
    button.disabled = true;
    await kept.ready;
    const earlier = [...kept.waiting.values()].sort((a, b) => a[0] - b[0]);
    count = earlier.length;
    heardAt = performance.now();
    running = true;
    send({ begin: earlier.map(message_of) });
    button.textContent = "Stop";
    button.disabled = false;
  }

  button.addEventListener(
    "click",
    () => (running ? send({ end: "stopped by the person" }) : begin()),
    { signal },
  );
  document.addEventListener(
    "visibilitychange",
    () => {
      if (document.hidden && running) fly({ pause: "the page is hidden" });
    },
    { signal },
  );
  model.on("msg:custom", heard);
  timer = setInterval(tell, EVERY);
  requestAnimationFrame(frame);
  return () => {
    leaving.abort();
    clearInterval(timer);
    model.off?.("msg:custom", heard);
    if (running) fly({ pause: "the view was closed" });
    running = false;
    kept.close();
  };
}

export default { render };
