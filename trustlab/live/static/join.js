// Takes the next free place of a study, and opens its page.
const trouble = document.getElementById("trouble");

document.querySelector("button").addEventListener("click", async () => {
  const headers = { "Content-Type": "application/json" },
    answer = await fetch(location.pathname, { method: "POST", body: "{}", headers }),
    { link, error } = await answer.json();
  if (link) location.replace(link);
  trouble.textContent = error ?? "";
  trouble.hidden = !error;
});
