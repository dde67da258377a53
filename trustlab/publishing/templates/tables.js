"use strict";
// Tables are sorted, filtered, unfolded and saved within the page; without this script all of them
// stand there whole.
const FOLDED = 15;
const make = (name, about) => Object.assign(document.createElement(name), about);
const value = (cell) => (cell.dataset.value ?? cell.textContent).trim();
const number = (text) =>
  /^[<>\s]*[-+−]?[\d.,]+(e[-+]?\d+)?\s*%?$/i.test(text)
    ? parseFloat(text.replace(/[<>\s,]/g, "").replace("−", "-"))
    : NaN;

function asCsv(table) {
  const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  return [...table.rows]
    .map((row) => [...row.cells].map((cell) => quoted(value(cell))).join(","))
    .join("\n");
}

function order(table, column, upwards) {
  const key = (row) => value(row.cells[column]);
  const before = (a, b) => {
    const x = number(key(a)),
      y = number(key(b));
    if (Number.isNaN(x) || Number.isNaN(y))
      return Number.isNaN(x) - Number.isNaN(y) || key(a).localeCompare(key(b));
    return x - y;
  };
  const rows = [...table.tBodies[0].rows].sort(before);
  table.tBodies[0].append(...(upwards ? rows : rows.reverse()));
}

// pandas counts the rows of a table that have no names of their own; nobody reads that column.
function dropCount(table) {
  const cells = [...table.rows].map((row) => row.cells[0]);
  const [head, first, ...others] = cells.map((cell) => cell?.textContent.trim());
  if (head !== "" || first !== "0" || table.querySelector("[rowspan], [colspan]")) return;
  if (others.every((text) => /^\d+$/.test(text))) cells.forEach((cell) => cell.remove());
}

function sortable(table) {
  const heads = [...table.tHead.rows].at(-1).cells;
  [...heads].forEach((head, column) => {
    const button = make("button", {
      type: "button",
      className: "sort",
      title: "sort by this column",
    });
    // no link within a button
    head.querySelectorAll("a").forEach((link) => link.replaceWith(...link.childNodes));
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const upwards = head.ariaSort !== "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.ariaSort = upwards ? "ascending" : "descending";
      order(table, column, upwards);
    });
  });
}

function foldable(table, bar, count) {
  const all = make("button", {
    type: "button",
    textContent: `show all ${count} rows`,
    ariaExpanded: "false",
  });
  const fold = (folded) => {
    table.classList.toggle("folded", folded);
    all.textContent = folded ? `show all ${count} rows` : `show ${FOLDED} rows`;
    all.ariaExpanded = String(!folded);
  };
  const filter = make("input", {
    type: "search",
    placeholder: "filter rows",
    ariaLabel: "filter rows",
  });
  const told = make("output", {});
  filter.addEventListener("input", () => {
    const words = filter.value.toLowerCase().split(/\s+/);
    let found = 0;
    for (const row of table.tBodies[0].rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      found += !row.hidden;
    }
    fold(!filter.value.trim());
    told.textContent = filter.value.trim() ? `${found} of ${count} rows` : "";
  });
  all.addEventListener("click", () => fold(!table.classList.contains("folded")));
  bar.append(filter, all, told);
  fold(true);
  const named = () =>
    location.hash &&
    table.querySelector(`[id="${CSS.escape(decodeURIComponent(location.hash.slice(1)))}"]`);
  const unfold = () => {
    const row = named();
    if (row) {
      fold(false);
      row.scrollIntoView();
    }
  };
  addEventListener("hashchange", unfold);
  unfold();
}

function equip(table, place) {
  const body = table.tBodies[0];
  if (!table.tHead || !body) return;
  dropCount(table);
  // Where rows are grouped, the first cell of a row may be one of its second column.
  for (const {
    cells: [cell],
  } of table.rows)
    if (cell?.offsetLeft === 0 && cell.colSpan === 1) cell.classList.add("first");
  if (body.rows.length < 3) return;
  const bar = make("div", { className: "tools" });
  if (!body.querySelector("[rowspan], [colspan]")) {
    sortable(table);
    if (body.rows.length > FOLDED + 5) foldable(table, bar, body.rows.length);
  }
  const save = make("a", {
    href: "#",
    textContent: "CSV",
    title: "save this table as CSV",
    download: `${document.title}, table ${place + 1}.csv`,
  });
  save.addEventListener("click", () => {
    save.href = `data:text/csv;charset=utf-8,${encodeURIComponent(asCsv(table))}`;
  });
  bar.append(save);
  table.closest(".scroll").before(bar);
}

addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll(".scroll table").forEach(equip);
  // What scrolls can be reached by keyboard.
  document.querySelectorAll(".equation, pre").forEach((one) => {
    if (one.scrollWidth > one.clientWidth) one.tabIndex = 0;
  });
});
