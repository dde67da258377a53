// A participant's pages. What is shown next is the server's to say; words are set as text, never as
// markup.
import { complain, element, filled, posted } from "./page.js";
import { play } from "./play.js";

const base = location.pathname.replace(/\/$/, "");
const main = document.querySelector("main");
// What pages say, in the study's language.
const words = JSON.parse(document.body.dataset.words);
// For the experimenter's eyes, and for tests
const status = (self.study = { page: null, kind: null, rows: 0 });

// One request. Returns {status, ...answer}; where the server is away or busy it is asked again
// until it answers.
async function ask(what, body) {
  for (let wait = 300; ; wait = Math.min(2 * wait, 4000)) {
    try {
      const options = body ? posted(body) : {};
      options.signal = AbortSignal.timeout(120000);
      const answer = await fetch(`${base}/${what}`, options);
      const number = answer.status;
      if (number === 507) complain(words.disk);
      else if (number >= 500) complain(filled(words.fault, { status: number }));
      else if (number !== 429) {
        complain("");
        return { status: number, ...(await answer.json()) };
      }
    } catch {
      complain(words.no_connection);
    }
    await new Promise((ok) => setTimeout(ok, wait));
  }
}

function paragraphs(text) {
  return text
    .split(/\n\s*\n/)
    .filter(Boolean)
    .map((part) => element("p", { textContent: part }));
}

// A button to tick or to choose, with its words.
const option = (type, name, value, text) =>
  element("label", {}, element("input", { type, name, value, required: true }), ` ${text} `);

function scale(item) {
  const fine = (item.high - item.low) / item.step > 10,
    points = element("div", { className: "points" });
  for (let value = item.low; value <= item.high; value += item.step)
    points.append(option("radio", item.name, value, value));
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
  else if (item.kind === "check") box.append(option("checkbox", item.name, "on", item.text));
  else box.append(...item.choices.map((choice) => option("radio", item.name, choice, choice)));
  return box;
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
    element("h1", { textContent: now.title }),
    ...paragraphs(now.text),
    ...now.items.map(field),
  );
  const button = element("button", { textContent: words.next });
  form.append(button);
  main.replaceChildren(form);
  return new Promise((next) => {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      button.disabled = true;
      const answer = await ask("answers", { page: now.page, answers: read(form, now.items) });
      button.disabled = false;
      if ([200, 404, 409].includes(answer.status)) next(); // or done before, or nobody's any more
      else complain(filled(words.not_taken, { error: answer.error }));
    });
  });
}

async function showDrive(now) {
  const go = element("button", { textContent: words.start });
  main.replaceChildren(element("h1", { textContent: now.title }), ...paragraphs(now.text), go);
  await new Promise((ok) => go.addEventListener("click", ok, { once: true }));
  const root = element("div", { id: "drive" }),
    url = `${location.origin.replace("http", "ws")}${base}/drive/${now.page}`;
  main.replaceChildren(root);
  const why = await new Promise((end) => {
    status.run = play(root, () => new WebSocket(url), {
      heard: ({ k }) => (status.rows = k),
      say: complain,
      end,
    });
  });
  complain("");
  if (!why) return;
  main.replaceChildren(element("p", { textContent: why }));
  await new Promise(() => {});
}

// The way out, on every page: before the first one is done it means not to take part at all.
function offerWithdrawal(now) {
  const place = document.getElementById("withdraw"),
    [text, question] =
      now.page === 0 ? [words.decline, words.decline_sure] : [words.withdraw, words.withdraw_sure];
  const onclick = async () => {
    if (!confirm(question)) return;
    button.disabled = true;
    await ask("withdraw", {});
    location.reload();
  };
  const button = element("button", {
    className: "quiet",
    type: "button",
    textContent: text,
    onclick,
  });
  place.replaceChildren(...(now.kind === "end" ? [] : [button]));
}

async function run() {
  for (;;) {
    const now = await ask("state");
    if (now.status === 404) return location.reload(); // the link no longer leads here
    if (now.status !== 200)
      return main.replaceChildren(element("p", { textContent: now.error }));
    Object.assign(status, { page: now.page, kind: now.kind, rows: 0 });
    const banner = document.getElementById("rehearsal");
    banner.hidden = !now.rehearsal;
    banner.textContent = words.rehearsal;
    const ended = now.kind === "end";
    document.getElementById("where").textContent = ended
      ? now.code
      : filled(words.where, { code: now.code, page: now.page + 1, pages: now.pages });
    offerWithdrawal(now);
    if (ended) {
      main.replaceChildren(element("h1", { textContent: now.title }), ...paragraphs(now.text));
      const textContent = filled(words.completion, { completion: now.completion });
      if (now.completion) main.append(element("p", { id: "completion", textContent }));
      return;
    }
    await (now.kind === "drive" ? showDrive(now) : showForm(now));
    scrollTo(0, 0);
  }
}

run().catch((error) => complain(filled(words.stopped, { error: error.message })));
