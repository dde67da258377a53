// The widget of a notebook: a start button, the drive, and its rows by the kernel's messages.
import { drive } from "./drive.js";
import { element, keepKeys, say } from "./page.js";
import { Rows } from "./rows.js";
import { steer } from "./steer.js";

// Ask the kernel; the answer carries the number of the question. A kernel that is busy or gone
// answers late or never.
function asking(model) {
  const open = new Map();
  let last = 0;
  model.on("msg:custom", (answer) => {
    open.get(answer.id)?.(answer);
    open.delete(answer.id);
  });
  return (message) =>
    new Promise((ok) => {
      const id = ++last;
      open.set(id, ok);
      setTimeout(() => {
        open.delete(id);
        ok({});
      }, 5000);
      try {
        model.send({ id, ...message });
      } catch {
        ok({});
      } // after a restart there is nobody to send to
    });
}

async function render({ model, el }) {
  const key = model.get("key"),
    words = model.get("config").words,
    tab = crypto.getRandomValues(new Uint32Array(3)).join("-"), // one window drives at a time
    ask = asking(model),
    start = element("button", { textContent: words.start_driving }),
    root = element("div"),
    trouble = element("p", { role: "alert" });
  let driving = null,
    rows = null;
  keepKeys(start);
  el.append(start, root, trouble);

  function end(message) {
    driving?.stop();
    say(trouble, message);
  }

  // Rows of a window on their way to the kernel.
  function delivery(name) {
    const every = model.get("config").served ? 60 : 500;
    const send = async (batch) => {
      const answer = await ask({ window: name, rows: batch });
      if (answer.refused) {
        await sending.drop();
        if (name === tab) end(answer.refused);
      } else if (name === tab && driving)
        say(trouble, answer.trouble ?? (sending.pending() > 100 ? words.silent : ""));
      if (name === tab && answer.have !== undefined)
        queueMicrotask(() => driving?.heard?.(answer)); // its mistakes are its own
      return answer.have;
    };
    const sending = new Rows(`${key}/${name}`, send, { every });
    return sending;
  }

  // Bring rows that a kernel which is gone did not take.
  async function bringLeft() {
    for (const left of await Rows.left(`${key}/`)) {
      const sending = delivery(left.slice(key.length + 1));
      await sending.ready;
      for (let tries = 0; sending.pending() && tries < 50; tries += 1) {
        await sending.flush();
        await new Promise((ok) => setTimeout(ok, 100));
      }
      sending.close();
    }
  }

  async function begin() {
    start.disabled = true;
    await bringLeft();
    let begun = {};
    while (!begun.rows) {
      begun = await ask({ begin: true, window: tab });
      say(trouble, begun.rows ? "" : (begun.trouble ?? words.silent));
    }
    const wasm = model.get("wasm"),
      bytes = new Uint8Array(wasm.buffer, wasm.byteOffset, wasm.byteLength);
    start.remove();
    const config = { ...model.get("config"), rows: begun.rows };
    rows = delivery(tab);
    const on = {
      row(k, values) {
        rows.add(k, values);
        if (rows.pending() > 100 && !trouble.textContent) say(trouble, words.silent);
      },
      note: (note) => ask({ window: tab, note }),
      async end(summary) {
        if (config.served) await rows.drop(); // commands beyond the end lead nowhere
        else await rows.drain();
        let answer = {};
        while (answer.have === undefined && !answer.refused)
          answer = await ask({ window: tab, end: summary });
        if (!answer.refused) root.append(element("p", { textContent: words.over }));
      },
    };
    driving = await (config.served
      ? steer(root, config, on)
      : drive(root, config, bytes, on));
    root.driving = driving;
  }
  start.addEventListener("click", begin);
  return () => {
    driving?.stop();
    rows?.close();
  };
}

export default { render };
