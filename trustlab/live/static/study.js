// A participant's pages. What is shown next is the server's to say; words are set as text, never as
// markup.
import { drive } from "./drive.js";
import { Flight } from "./flight.js";
import { Lead } from "./lead.js";
import { element, filled } from "./page.js";
import { Rows } from "./rows.js";
import { steer } from "./steer.js";

const COMPUTED = { teleoperation: Flight, team: Lead };
const EVERY_COMMAND = 60; // ms between two sendings to a server that computes
const base = location.pathname.replace(/\/$/, "");
const main = document.querySelector("main"),
  trouble = document.getElementById("trouble");
// What pages say, in the study's language; the server tells with the first page.
let words = {
  no_connection: "No connection. This page goes on by itself when the connection is back.",
  fault: "The study's computer has made a mistake (error {status}). This page tries again.",
  disk: "The study's computer cannot save at the moment. This page goes on by itself.",
};
// This window: one window drives at a time
const tab = crypto.getRandomValues(new Uint32Array(3)).join("-");
// For the experimenter's eyes, and for tests
const status = (self.study = { page: null, kind: null, rows: 0, pending: 0 });

function complain(text) {
  trouble.textContent = text;
  trouble.hidden = !text;
}

// Say that the server is in trouble: a full disk has a status of its own.
const troubled = (code) =>
  complain(code === 507 ? words.disk : filled(words.fault, { status: code }));

const pause = (ms) => new Promise((ok) => setTimeout(ok, ms));

// One request. Returns {status, ...answer}; where the server is away or busy it is asked again
// until it answers.
async function ask(what, body) {
  for (let wait = 300; ; wait = Math.min(2 * wait, 4000)) {
    try {
      const options = body && {
        method: "POST",
        body: JSON.stringify(body),
        headers: { "Content-Type": "application/json" },
      };
      const answer = await fetch(`${base}/${what}`, {
        ...options,
        signal: AbortSignal.timeout(120000),
      });
      if (answer.status >= 500) troubled(answer.status);
      else if (answer.status !== 429) {
        complain("");
        return { status: answer.status, ...(await answer.json()) };
      }
    } catch {
      complain(words.no_connection);
    }
    await pause(wait);
  }
}

function paragraphs(text) {
  return text
    .split(/\n\s*\n/)
    .filter(Boolean)
    .map((part) => element("p", { textContent: part }));
}

function scale(item) {
  const fine = (item.high - item.low) / item.step > 10,
    points = element("div", { className: "points" });
  for (let value = item.low; value <= item.high; value += item.step) {
    const input = element("input", { type: "radio", name: item.name, value, required: true });
    points.append(element("label", {}, input, String(value)));
  }
  const end = (text) => element("span", { className: "end", textContent: text });
  const box = element("div", { className: fine ? "scale fine" : "scale" });
  box.append(end(item.left), points, end(item.right));
  return box;
}

function field(item) {
  const box = element(
    "fieldset",
    {},
    element("legend", { textContent: item.kind === "check" ? "" : item.text }),
  );
  if (item.kind === "scale") box.append(scale(item));
  else if (item.kind === "text")
    box.append(
      element("textarea", {
        name: item.name,
        maxLength: 1000,
        rows: 3,
        ariaLabel: item.text,
        required: item.required,
      }),
    );
  else if (item.kind === "check")
    box.append(
      element(
        "label",
        {},
        element("input", { type: "checkbox", name: item.name, required: true }),
        ` ${item.text}`,
      ),
    );
  else
    for (const choice of item.choices)
      box.append(
        element(
          "label",
          {},
          element("input", { type: "radio", name: item.name, value: choice, required: true }),
          ` ${choice} `,
        ),
      );
  return box;
}

function answered(form, item) {
  const value = new FormData(form).get(item.name);
  return value !== null && value !== "";
}

function read(form, items) {
  const data = new FormData(form);
  const value = {
    scale: Number,
    check: (text) => text !== null,
    text: String,
    choice: String,
  };
  return Object.fromEntries(
    items.map((item) => [item.name, value[item.kind](data.get(item.name))]),
  );
}

// Show a form and return what follows when its answers are taken.
function showForm(now) {
  const form = element(
    "form",
    {},
    element("h2", { textContent: now.title }),
    ...paragraphs(now.text),
    ...(now.picture ? [element("img", { src: now.picture, alt: now.title })] : []),
    ...now.items.map(field),
  );
  const button = element("button", { textContent: words.next });
  if (now.page === 0) {
    const values = { pages: now.pages, minutes: now.minutes };
    const text = filled(words.duration, values);
    form.querySelector("h2").after(element("p", { id: "duration", textContent: text }));
  }
  form.append(button);
  main.replaceChildren(form);
  return new Promise((next) => {
    let late = false;
    const timer = now.seconds && setTimeout(() => handIn((late = true)), 1000 * now.seconds);
    async function handIn() {
      clearTimeout(timer);
      button.disabled = true;
      const items = late ? now.items.filter((item) => answered(form, item)) : now.items;
      const answer = await ask("answers", { page: now.page, late, answers: read(form, items) });
      button.disabled = false;
      if (answer.status === 200 || answer.status === 409) next();
      else complain(filled(words.not_taken, { error: answer.error }));
    }
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      handIn();
    });
  });
}

// Rows of one attempt, on their way to the server; `stale` is called when this window must not go
// on.
function delivery(code, page, attempt, window, stale, driven = () => null, every = 500) {
  const post = (batch, options) => {
    const body = JSON.stringify({
      page,
      attempt,
      tab: window,
      rows: batch,
      telemetry: driven()?.telemetry?.() ?? {},
    });
    return fetch(`${base}/rows`, {
      method: "POST",
      body,
      headers: { "Content-Type": "application/json" },
      ...options,
    });
  };
  const leave = (batch) => post(batch.slice(0, 100), { keepalive: true }).catch(() => {});
  const rows = new Rows(
    `${code}/${page}/${attempt}/${window}`,
    async (batch) => {
      status.pending = rows.pending();
      const answer = await post(batch, { signal: AbortSignal.timeout(5000) });
      if (answer.status >= 500) troubled(answer.status);
      if ([400, 404, 409, 413].includes(answer.status)) {
        const { error, window: elsewhere } = await answer.json().catch(() => ({}));
        await rows.drop(); // sending them again would not help
        if (answer.status === 409) stale(elsewhere ? words.other_window : "");
        else stale(filled(words.stopped, { error: error ?? answer.status }));
      }
      if (!answer.ok) return undefined;
      complain("");
      const { have, current, picture } = await answer.json();
      if (!current) stale("");
      status.pending = 0;
      queueMicrotask(() => driven()?.heard?.({ have, picture })); // its mistakes are its own
      return have;
    },
    { leave, every },
  );
  return rows;
}

// Bring rows to the server that earlier pages of this participant left in this browser.
async function bringLeft(code) {
  for (const key of await Rows.left(`${code}/`)) {
    const [, page, attempt, window] = key.split("/");
    await delivery(code, Number(page), Number(attempt), window, () => {}).drain();
  }
}

// Begin what a drive's settings say: computed by the server, or here.
async function beginDrive(root, config, memory, on) {
  if (config.served) return steer(root, config, on);
  const wasm = await (await fetch("/static/kernel.wasm")).arrayBuffer();
  const run = memory && (await COMPUTED[config.live_task].load(wasm, config, memory));
  if (run) return steer(root, config, on, run);
  return drive(root, config, wasm, on);
}

async function showDrive(now) {
  const go = element("button", { textContent: words.start });
  main.replaceChildren(element("h2", { textContent: now.title }), ...paragraphs(now.text), go);
  await new Promise((ok) => go.addEventListener("click", ok, { once: true }));
  const begun = await ask("begin", { page: now.page, tab });
  if (begun.status !== 200) return;
  const root = element("div", { id: "drive" });
  main.replaceChildren(root);
  const about = { page: now.page, attempt: begun.attempt, tab };
  let driving = null,
    count = begun.rows.length;
  const outcome = await new Promise((ended, failed) => {
    const rows = delivery(
      now.code,
      now.page,
      begun.attempt,
      tab,
      (why) => ended({ why, rows }),
      () => driving,
      begun.config.served ? EVERY_COMMAND : undefined,
    );
    const on = {
      row: (k, values) => {
        rows.add(k, values);
        count = status.rows = k + 1;
      },
      note: (text) => ask("note", { ...about, row: count, text }),
      end: (summary) => ended({ summary, rows }),
    };
    const config = { ...begun.config, rows: begun.rows };
    beginDrive(root, config, begun.memory, on).then((made) => {
      driving = status.driving = made;
    }, failed);
  });
  driving?.stop?.();
  if (!outcome.summary) {
    outcome.rows.close();
    if (outcome.why) {
      main.replaceChildren(element("p", { textContent: outcome.why }));
      await new Promise(() => {});
    }
    return;
  }
  main.replaceChildren(element("p", { textContent: words.saving }));
  if (begun.config.served) {
    count = outcome.summary.rows;
    await outcome.rows.drop(); // commands beyond the end lead nowhere
  } else await outcome.rows.drain();
  await ask("done", { ...about, rows: count, telemetry: driving?.telemetry?.() ?? {} });
}

const code = (now) => filled(words.completion, { completion: now.completion });

// The way out, on every page: before the first one is done it means not to take part at all.
function offerWithdrawal(now) {
  const place = document.getElementById("withdraw"),
    [text, question] =
      now.page === 0 ? [words.decline, words.decline_sure] : [words.withdraw, words.withdraw_sure];
  const button = element("button", { className: "quiet", type: "button", textContent: text });
  button.addEventListener("click", async () => {
    if (!confirm(question)) return;
    button.disabled = true;
    await ask("withdraw", {});
    status.pending = 0; // rows that are on their way do not keep anybody
    location.reload();
  });
  place.replaceChildren(...(now.kind === "end" ? [] : [button]));
}

async function run() {
  for (;;) {
    const now = await ask("state");
    if (now.status !== 200)
      return main.replaceChildren(
        element("p", {
          textContent:
            "This link leads to no study. Please ask the person who runs the study for yours.",
        }),
      );
    words = now.words;
    document.documentElement.lang = now.language;
    await bringLeft(now.code);
    Object.assign(status, { page: now.page, kind: now.kind, rows: 0 });
    const banner = document.getElementById("rehearsal");
    banner.hidden = !now.rehearsal;
    banner.textContent = words.rehearsal;
    const ended = now.kind === "end";
    document.getElementById("where").textContent = ended
      ? now.code
      : filled(words.where, { code: now.code, page: now.page + 1, pages: now.pages });
    offerWithdrawal(now);
    if (ended)
      return main.replaceChildren(
        element("h2", { textContent: now.title }),
        ...paragraphs(now.text),
        ...(now.completion ? [element("p", { id: "completion", textContent: code(now) })] : []),
      );
    await (now.kind === "drive" ? showDrive(now) : showForm(now));
    scrollTo(0, 0);
  }
}

addEventListener("beforeunload", (event) => {
  if (status.pending) event.preventDefault();
});
run().catch((error) =>
  complain(filled(words.stopped ?? "This page cannot go on ({error}).", { error: error.message })),
);
