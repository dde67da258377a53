// The experimenter's page: who is where, once a second; restart a drive, add a note, end a
// participation.
import { complain, element, posted } from "./page.js";

const base = location.pathname.replace(/\/$/, "");
const table = document.querySelector("tbody");
let refused = ""; // why the last action was not done: it stays until the next one

async function act(body) {
  const answer = await fetch(`${base}/act`, posted(body)),
    told = await answer.json().catch(() => ({}));
  refused = answer.ok ? "" : `That could not be done: ${told.error ?? `error ${answer.status}`}`;
  if (answer.ok) show(told);
  complain(refused);
}

function buttons(who) {
  const participant = who.code,
    box = element("div");
  const button = (words, action) =>
    box.append(element("button", { className: "quiet", textContent: words, onclick: action }), " ");
  for (const { page, title } of who.drives)
    button(
      `Restart “${title}”`,
      () =>
        confirm(`${participant}: drive “${title}” and its questions again? All is kept.`) &&
        act({ participant, action: "restart", page }),
    );
  button("Note", () => {
    const text = prompt(`A note about ${participant}`);
    if (text?.trim()) act({ participant, action: "note", text });
  });
  if (who.page < who.pages)
    button(
      "End",
      () =>
        confirm(`End the participation of ${participant}?`) && act({ participant, action: "end" }),
    );
  return box;
}

function pace(who) {
  const parts = [];
  if (who.rows !== null) parts.push(`${who.rows} rows`);
  if (who.delay) parts.push(`pictures ${who.delay.toFixed(2)} s late`);
  if (who.pauses) parts.push(`pauses: ${who.pauses}`);
  return parts.join(", ");
}

const people = new Map(); // code → the cells of its row, and what its last cell was made of

function newRow(who) {
  const copy = element("button", {
    className: "quiet",
    textContent: "Copy link",
    onclick: () => navigator.clipboard.writeText(who.link),
  });
  const cells = Array.from({ length: 6 }, () => element("td"));
  const row = element(
    "tr",
    { id: who.code },
    element("td", {}, who.code, element("br"), copy),
    ...cells,
  );
  return { row, cells, made: "" };
}

// Only words are changed once a second, so that a button stays the same while it is pressed.
function update(who) {
  if (!people.has(who.code)) people.set(who.code, newRow(who));
  const person = people.get(who.code);
  const [order, page, seen, drive, model, last] = person.cells;
  const away =
    who.seconds_ago === null
      ? "not yet"
      : who.seconds_ago < 5
        ? "here"
        : `${Math.round(who.seconds_ago)} s ago`;
  order.textContent = who.order.join(" ");
  const number = who.page < who.pages ? `${who.page + 1} of ${who.pages}: ` : "";
  const condition = who.condition ? ` (${who.condition})` : "";
  const end = who.withdrawn ? ", withdrawn" : who.ended ? ", ended" : "";
  page.textContent = `${number}${who.title}${condition}${end}`;
  seen.textContent = away;
  seen.className = away === "here" ? "" : "away";
  drive.textContent = pace(who);
  model.textContent = who.model ? `${who.model}${who.why ? `: ${who.why}` : ""}` : "";
  model.className = who.why ? "away" : "";
  const parts = JSON.stringify([who.drives, who.notes, who.page < who.pages]);
  if (parts !== person.made) {
    const words = who.notes.map((note) =>
      element("p", { textContent: note.text ?? `${note.file}: ${note.bytes} bytes cut off` }),
    );
    last.replaceChildren(...words, buttons(who));
    person.made = parts;
  }
  return person.row;
}

function show(state) {
  const gone = state.deleted ? ` ${state.deleted} deleted.` : "";
  document.querySelector("h1").textContent =
    `Study ${state.study}${state.rehearsal ? " (rehearsal by scripted hands)" : ""}`;
  document.getElementById("about").textContent =
    `${state.people.length} participants.${gone} ` +
    "This page and the links on it are for the experimenter only.";
  const join = document.getElementById("join");
  join.hidden = !state.join;
  join.href = state.join;
  const rows = state.people.map(update);
  if (table.childElementCount !== rows.length) table.replaceChildren(...rows);
}

async function watch() {
  for (;;) {
    try {
      const answer = await fetch(`${base}/state`, { signal: AbortSignal.timeout(5000) });
      if (answer.ok) {
        const state = await answer.json();
        show(state);
        complain(`${refused} ${state.trouble}`.trim());
      } else complain(`The server answers with error ${answer.status}; see its terminal.`);
    } catch {
      complain("The server does not answer.");
    }
    await new Promise((ok) => setTimeout(ok, 1000));
  }
}

watch();
