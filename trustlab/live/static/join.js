// Takes the next free place of a study, and opens its page.
import { complain, posted } from "./page.js";

const button = document.querySelector("button");
button.addEventListener("click", async () => {
  button.disabled = true; // a second click would take another place
  try {
    const answer = await fetch(location.pathname, posted({})),
      { link, error } = await answer.json();
    if (link) location.replace(link);
    else complain(error);
  } catch {
    complain(button.dataset.failed);
  } finally {
    button.disabled = false;
  }
});
