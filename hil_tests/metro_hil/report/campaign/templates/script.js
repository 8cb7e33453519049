"use strict";
document.documentElement.classList.add("js");

// Sort a table by the column whose head is clicked: as numbers where both cells hold one.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.addEventListener("click", () => {
    const up = head.dataset.order !== "up";
    heads.forEach(other => delete other.dataset.order);
    head.dataset.order = up ? "up" : "down";
    const key = row => row.cells[column].dataset.key ?? row.cells[column].textContent.trim();
    const number = text => parseFloat(text.replace("−", "-"));
    const rows = [...table.tBodies[0].rows].sort((a, b) => {
      const [x, y] = [number(key(a)), number(key(b))];
      const order = isNaN(x) || isNaN(y) ? key(a).localeCompare(key(b)) : x - y;
      return up ? order : -order;
    });
    table.tBodies[0].append(...rows);
  }));
}

// Show only what holds the words.
for (const input of document.querySelectorAll("input.filter")) {
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const item of document.querySelectorAll(input.dataset.of)) {
      const text = item.textContent.toLowerCase();
      item.hidden = !words.every(word => text.includes(word));
    }
  });
}

// A quicker tooltip than the browser's.
const tip = document.createElement("div");
tip.id = "tip"; tip.hidden = true; document.body.append(tip);
document.addEventListener("mouseover", event => {
  const over = event.target.closest("[title], [data-tip]");
  if (over?.title) { over.dataset.tip = over.title; over.removeAttribute("title"); }
  tip.hidden = !over?.dataset.tip;
  if (!tip.hidden) tip.textContent = over.dataset.tip;
});
document.addEventListener("mousemove", event => {
  tip.style.left = Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8) + "px";
  tip.style.top = Math.min(event.clientY + 16, innerHeight - tip.offsetHeight - 8) + "px";
});

// Open what a link leads to.
const open = () => { const target = location.hash && document.querySelector(CSS.escape ? "#" + CSS.escape(location.hash.slice(1)) : location.hash); if (target?.tagName === "DETAILS") target.open = true; };
addEventListener("hashchange", open); open();
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(item => { item.open = true; }));
