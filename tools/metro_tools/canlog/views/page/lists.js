// Events and messages as tables.

function eventList() {
  const box = document.getElementById("tab-events"), events = view.head.events;
  document.getElementById("events-count").textContent = grouped(events.length);
  if (!events.length) { box.innerHTML = '<p class="nothing">This log tells of no events.</p>'; return; }
  const table = document.createElement("table");
  table.innerHTML = "<thead><tr><th class='n'>time, s</th><th>event</th><th>what and why</th><th>from</th></tr></thead>";
  const body = table.createTBody();
  for (const event of events) {
    const row = body.insertRow();
    row.dataset.t = event.t; row.tabIndex = 0;
    row.innerHTML = `<td class="n">${timeText(event.t, 3)}</td><td><span class="kind w${event.weight}"></span></td><td></td><td></td>`;
    row.querySelector(".kind").textContent = event.kind.toLowerCase().replaceAll("_", " ");
    row.cells[2].textContent = event.words;
    for (const basis of event.basis) {
      const link = document.createElement("a");
      link.className = "src"; link.textContent = basis.source.toLowerCase() === basis.source ? basis.source : basis.source;
      link.title = `${basis.payload ? `${basis.payload.toUpperCase()}, ` : ""}${basis.t === null ? "never heard" : `heard ${spanText(event.t - basis.t)} before`}`;
      link.onclick = click => { click.stopPropagation(); if (basis.t !== null) { showTab("frames"); goTo(basis.t); } };
      row.cells[3].append(link);
    }
    row.onclick = () => goTo(event.t);
    row.onkeydown = key => { if (key.key === "Enter") goTo(event.t); };
  }
  box.replaceChildren(table);
}

// Marks the last event at or before the cursor.
function followEvents() {
  const box = document.getElementById("tab-events"), t = view.cursor;
  if (box.hidden) return;
  const rows = [...box.querySelectorAll("tbody tr")];
  let last = -1;
  if (t !== null) rows.forEach((row, at) => { if (Number(row.dataset.t) <= t + 1) last = at; });
  rows.forEach((row, at) => row.classList.toggle("at", at === last));
  if (last >= 0 && view.pinned) rows[last].scrollIntoView({ block: "nearest" });
}

function nextEvent(by) {
  const t = view.cursor ?? (view.from + view.to) / 2;
  const found = by > 0 ? view.head.events.find(event => event.t > t + 1) : view.head.events.findLast(event => event.t < t - 1);
  if (found) { goTo(found.t); announce(found); }
}

let announcing = 0;
function announce(event) {
  document.getElementById("facts").textContent = `${timeText(event.t, 3)} s  ${event.kind.toLowerCase().replaceAll("_", " ")}: ${event.words}`;
  clearTimeout(announcing);
  announcing = setTimeout(showFacts, 6000);
}

const STATS = [
  ["message", m => m.name], ["id", m => m.idText], ["from", m => (m.senders || []).join(", ")],
  ["frames", m => m.facts.count, grouped], ["per second", m => m.facts.rate ?? null, value => value.toFixed(2)],
  ["period, ms", m => m.facts.period || null], ["least gap", m => m.facts.gap?.[0] ?? null, ms], ["1 %", m => m.facts.gap?.[1] ?? null, ms],
  ["median", m => m.facts.gap?.[2] ?? null, ms], ["99 %", m => m.facts.gap?.[3] ?? null, ms],
  ["greatest gap", m => m.facts.gap?.[4] ?? null, ms], ["missing", m => m.facts.missing],
  ...["counter errors", "CRC errors"].map(name => [name, m => m.facts[name] ?? null]),
];
function ms(value) { return value.toFixed(3); }

function statsList() {
  const box = document.getElementById("tab-stats"), messages = [...view.head.messages];
  document.getElementById("stats-count").textContent = grouped(messages.length);
  const columns = STATS.filter(([, get]) => messages.some(message => get(message) !== null && get(message) !== ""));
  const table = document.createElement("table"), head = table.createTHead().insertRow(), body = table.createTBody();
  const numeric = ([, get]) => messages.some(message => typeof get(message) === "number");
  let order = null;
  const fill = () => body.replaceChildren(...messages.map(message => {
    const row = document.createElement("tr");
    row.title = message.comment || "";
    for (const column of columns) {
      const cell = row.insertCell(), value = column[1](message);
      if (numeric(column)) cell.className = "n";
      cell.textContent = value === null ? "" : typeof value === "number" && column[2] ? column[2](value) : value;
      const wrong = ["missing", "counter errors", "CRC errors"].includes(column[0]) && value > 0;
      const late = column[0] === "greatest gap" && message.timeout && value > message.timeout;
      if (wrong || late) cell.classList.add("bad");
    }
    row.onclick = () => { document.getElementById("filter").value = message.name; showTab("frames"); table_.filter(message.name); };
    return row;
  }));
  for (const column of columns) {
    const cell = document.createElement("th");
    cell.textContent = column[0];
    if (numeric(column)) cell.className = "n";
    cell.onclick = () => {
      order = order === column ? null : column;
      const sign = numeric(column) ? -1 : 1;
      messages.sort((a, b) => { const x = column[1](a) ?? -Infinity, y = column[1](b) ?? -Infinity; return (x < y ? -1 : x > y ? 1 : 0) * sign * (order ? 1 : -1); });
      fill();
    };
    head.append(cell);
  }
  fill();
  box.replaceChildren(table);
}

function showTab(name) {
  for (const button of document.querySelectorAll("#dock [data-tab]")) button.setAttribute("aria-selected", button.dataset.tab === name);
  for (const each of ["frames", "events", "stats"]) document.getElementById(`tab-${each}`).hidden = each !== name;
  document.getElementById("filter").hidden = document.getElementById("filter-note").hidden = name !== "frames";
  if (name === "frames") table_.follow().then(() => table_.draw());
  if (name === "events") followEvents();
}
