"use strict";
// Sorting and filtering; without script the page shows all runs, worst first.
const find = (id) => document.getElementById(id);
const words = find("words"), kind = find("kind"), order = find("order");
const body = document.querySelector("tbody"), rows = Array.from(body.rows);
const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));
const heads = Array.from(document.querySelectorAll("th[data-order]"));
let down = false;

function key(row) {
  if (order.value === "run") return row.querySelector(".about").textContent.trim();
  const text = row.cells[Number(order.value) + 1].dataset.key;
  return text === "" ? null : Number(text);
}

// Runs without the metric come last in either direction; equal ones keep the order of the page.
function compare(a, b) {
  if (a.key === null || b.key === null) return (a.key === null) - (b.key === null);
  const sign = typeof a.key === "string" ? a.key.localeCompare(b.key, "en", { numeric: true }) : a.key - b.key;
  return down ? -sign : sign;
}

function sort() {
  const worst = order.value === "worst";
  const sorted = worst ? rows : rows.map((row) => ({ row, key: key(row) })).sort(compare).map((item) => item.row);
  body.append(...sorted);
  for (const head of heads) {
    const mine = head.dataset.order === order.value;
    if (mine) head.setAttribute("aria-sort", down ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  }
}

function filter() {
  const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
  let count = 0;
  for (const row of rows) {
    const fits = wanted.every((word) => texts.get(row).includes(word));
    row.hidden = !fits || (kind.value !== "" && !row.dataset.kind.split(" ").includes(kind.value));
    count += !row.hidden;
  }
  find("shown").textContent = count === rows.length ? "" : `${count} of ${rows.length}`;
  find("none").hidden = count > 0;
}

for (const head of heads) {
  const button = document.createElement("button");
  button.type = "button";
  button.append(...head.childNodes);
  head.append(button);
  button.addEventListener("click", () => {
    down = order.value === head.dataset.order && !down;
    order.value = head.dataset.order;
    sort();
  });
}
order.addEventListener("change", () => { down = false; sort(); });
kind.addEventListener("change", filter);
words.addEventListener("input", filter);
document.querySelector(".tools").addEventListener("submit", (event) => event.preventDefault());
document.querySelector(".tools").hidden = false;
