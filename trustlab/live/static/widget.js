// The widget of a notebook: a start button, then a run over the kernel's messages.
import { element, keepKeys } from "./page.js";
import { play } from "./play.js";

// The kernel's messages as a channel; one that is gone is silent.
function channel(model) {
  const made = { readyState: 1, close: () => model.off("msg:custom", hear) };
  const hear = (answer) => made.onmessage?.({ data: JSON.stringify(answer) });
  made.send = (text) => {
    try {
      model.send(JSON.parse(text));
    } catch {
      // after a restart there is nobody to send to
    }
  };
  model.on("msg:custom", hear);
  setTimeout(() => made.onopen?.(), 0);
  return made;
}

function render({ model, el }) {
  const words = model.get("words"),
    start = element("button", { textContent: words.start_driving }),
    stop = element("button", { textContent: words.stop }),
    root = element("div"),
    trouble = element("p", { role: "alert" }),
    file = element("p", { className: "hint", textContent: `${words.log} ${model.get("path")}` });
  let run = null;
  keepKeys(start, stop);
  el.append(start, root, trouble, file);

  function end(why) {
    stop.remove();
    trouble.textContent = why || words.over;
  }

  start.addEventListener("click", () => {
    start.remove();
    el.insertBefore(stop, file);
    run = root.run = play(root, () => channel(model), {
      heard: () => {},
      say: (why) => (trouble.textContent = why),
      end,
    });
    stop.addEventListener("click", () => confirm(words.stop_sure) && model.send({ end: true }));
  });
  return () => run?.stop("");
}

export default { render };
