// The widget of a notebook: a start button, the drive, and its rows by the kernel's messages.
// Behind the modules that it uses, in one.

const SILENT =
  "The kernel does not answer. Nothing is lost: what is driven waits in this browser. " +
  "If the kernel was restarted, run the cell " +
  "again; if that does not help, reload the page.";

// Ask the kernel; the answer carries the number of the question. A kernel that is busy or gone
// answers late or never.
function asking(model) {
  const open = new Map();
  let last = 0;
  model.on("msg:custom", (said) => {
    open.get(said.id)?.(said);
    open.delete(said.id);
  });
  return (about) =>
    new Promise((ok) => {
      const id = ++last;
      open.set(id, ok);
      setTimeout(() => {
        open.delete(id);
        ok({});
      }, 5000);
      try {
        model.send({ id, ...about });
      } catch {
        ok({});
      } // after a restart there is nobody to send to
    });
}

async function render({ model, el }) {
  const ask = asking(model),
    start = element("button", "", "Start driving"),
    root = element("div"),
    trouble = element("p");
  const rows = new Rows(model.get("key"), async (batch) => (await ask({ rows: batch })).have);
  let driving = null;
  el.append(start, root, trouble);
  async function begin() {
    start.disabled = true;
    await rows.ready; // rows that a kernel which is gone did not take
    for (let tries = 0; rows.pending() && tries < 50; tries += 1) {
      await rows.flush();
      await new Promise((ok) => setTimeout(ok, 100));
    }
    let begun = {};
    while (!begun.rows) {
      begun = await ask({ begin: true });
      say(trouble, begun.rows ? "" : SILENT);
    }
    const wasm = model.get("wasm"),
      bytes = new Uint8Array(wasm.buffer, wasm.byteOffset, wasm.byteLength);
    start.remove();
    const on = {
      row(k, values) {
        rows.add(k, values);
        say(trouble, rows.pending() > 100 ? SILENT : "");
      },
      note: (note) => ask({ note }),
      async end(summary) {
        await rows.drain();
        await ask({ end: summary });
        root.append(element("p", "", "The drive is over, and all its rows are saved."));
      },
    };
    driving = await drive(root, { ...model.get("config"), rows: begun.rows }, bytes, on);
    root.driving = driving;
  }
  start.addEventListener("click", begin);
  return () => {
    driving?.stop();
    rows.close();
  };
}

export default { render };
