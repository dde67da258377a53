// Takes the next free place of a study, and opens its page.
import { complain, posted } from "./page.js";

document.querySelector("button").addEventListener("click", async () => {
  const answer = await fetch(location.pathname, posted({})),
    { link, error } = await answer.json();
  if (link) location.replace(link);
  complain(error ?? "");
});
