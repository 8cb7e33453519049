// Shows events and messages as tables.

function eventList() {
  const box = document.getElementById("tab-events"), events = view.head.events;
  document.getElementById("events-count").textContent = grouped(events.length);
  if (!events.length) { box.innerHTML = '<p class="nothing">This log has no events.</p>'; return; }
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
      link.className = "src"; link.textContent = basis.source;
      link.title = `${basis.payload ? `${basis.payload.toUpperCase()}, ` : ""}${basis.t === null ? "never received" : `received ${spanText(event.t - basis.t)} before`}`;
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

// Columns of `canlog stats` that are shown: name of the number, heading, digits, and the least bad
// value.
const STATS = [
  ["channel", "bus"], ["id", "id"], ["message", "message"], ["frames", "frames", 0], ["rate_hz", "per second", 2], ["load_ratio", "load, %", 2],
  ["period_ms", "period, ms", 0], ["gap_ms_min", "least gap", 3], ["gap_ms_p50", "median", 3], ["gap_ms_p99", "99 %", 3], ["gap_ms_max", "greatest", 3],
  ["jitter_ms", "jitter", 3], ["missing", "missing", 0, 1], ["extra", "extra", 0], ["stale", "stale", 0, 1], ["lost", "lost", 0, 1], ["crc_errors", "CRC", 0, 1],
  ["counter_errors", "counter", 0, 1], ["twin_errors", "twin", 0], ["invalid_values", "invalid", 0, 1], ["out_of_range", "out of range", 0, 1], ["latency_ms", "worst latency", 3],
];
const ALWAYS = 8; // number of columns that are shown even if they are empty

function statsList() {
  const box = document.getElementById("tab-stats"), rows = [...view.head.stats.messages];
  document.getElementById("stats-count").textContent = grouped(rows.length);
  const buses = new Set(rows.map(row => row.channel));
  const columns = STATS.filter(([name], at) => (name !== "channel" || buses.size > 1) && (at < ALWAYS || rows.some(row => row[name])));
  const table = document.createElement("table"), head = table.createTHead().insertRow(), body = table.createTBody();
  const fill = () => body.replaceChildren(...rows.map(row => statsRow(row, columns)));
  let sorted = null, sign = 1;
  for (const [name, heading, digits] of columns) {
    const cell = document.createElement("th");
    cell.textContent = heading;
    if (digits !== undefined) cell.className = "n";
    cell.onclick = () => {
      sign = sorted === name ? -sign : digits === undefined ? 1 : -1;
      sorted = name;
      rows.sort((a, b) => { const x = a[name] ?? -Infinity, y = b[name] ?? -Infinity; return (x < y ? -1 : x > y ? 1 : 0) * sign; });
      fill();
    };
    head.append(cell);
  }
  fill();
  const buses_ = document.createElement("p");
  buses_.className = "buses";
  buses_.textContent = view.head.stats.buses.map(bus =>
    `${bus.channel || "bus"}: load ${(100 * bus.bus_load_ratio).toFixed(1)} % of ${bus.baudrate / 1000} kbit/s, ${(100 * bus.bus_load_ratio_max).toFixed(1)} % in the fullest 100 ms; ` +
    `${bus.error_frames} error, ${bus.remote_frames} remote, ${bus.unknown_frames} unknown frames`).join("   ");
  box.replaceChildren(buses_, table, ...remarks(view.head.stats));
}

// Messages that never came, and what could not be judged and why; equal remarks share a line.
function remarks(stats) {
  const lines = stats.absent.length ? [`Never seen: ${listed(stats.absent)}`] : [], alike = new Map();
  for (const { message, what, why } of stats.not_judged) {
    const text = `${what}|${why}`;
    alike.set(text, [...alike.get(text) ?? [], message]);
  }
  for (const [text, names] of alike) {
    const [what, why] = text.split("|");
    lines.push(`Not judged: ${what} of ${listed(names)}: ${why}`);
  }
  return lines.map(text => { const line = document.createElement("p"); line.className = "buses"; line.textContent = text; return line; });
}
function listed(names) { return names.length > 8 ? `${names.slice(0, 8).join(", ")} and ${names.length - 8} more` : names.join(", "); }

function statsRow(told, columns) {
  const row = document.createElement("tr");
  row.title = view.head.messages.find(message => message.name === told.message)?.comment || "";
  for (const [name, , digits, bad] of columns) {
    const cell = row.insertCell(), value = name === "load_ratio" && told[name] !== null ? 100 * told[name] : told[name];
    if (digits !== undefined) cell.className = "n";
    cell.textContent = value === null || value === undefined || (name === "period_ms" && !value) ? "" : digits === undefined ? value : digits ? value.toFixed(digits) : grouped(Math.round(value));
    if (bad && value >= bad) cell.classList.add("bad");
  }
  row.onclick = () => { document.getElementById("filter").value = told.message; showTab("frames"); table_.filter(told.message); };
  return row;
}

function showTab(name) {
  for (const button of document.querySelectorAll("#dock [data-tab]")) button.setAttribute("aria-selected", button.dataset.tab === name);
  for (const each of ["frames", "events", "stats", "bits", "faults"]) document.getElementById(`tab-${each}`).hidden = each !== name;
  document.getElementById("filter").hidden = document.getElementById("filter-note").hidden = name !== "frames";
  if (name === "frames") table_.follow().then(() => table_.draw());
  if (name === "events") followEvents();
  if (name === "bits") bitsList();
}

// Which bits change, as in `canlog bits`: a bar for each byte, a stripe for each bit, highest first.
function bitsList() {
  const box = document.getElementById("tab-bits");
  if (box.children.length) return;
  const note = document.createElement("p"), table = document.createElement("table"), body = table.createTBody();
  note.className = "buses";
  note.textContent = "Each bar is a byte and each stripe a bit, highest first: the darker, the more often it changes from frame to frame. Below is the entropy of the byte in bits.";
  table.innerHTML = "<thead><tr><th>id</th><th>message</th><th class='n'>frames</th><th>bytes</th></tr></thead>";
  table.append(body);
  for (const message of view.head.messages) if (message.flips?.length) body.append(bitsRow(message));
  box.replaceChildren(note, table);
}

function bitsRow(message) {
  const row = document.createElement("tr"), steps = Math.max(1, message.count - 1);
  for (const [text, kind] of [[message.idText, ""], [message.name === message.idText ? "" : message.name, ""], [grouped(message.count), "n"]]) {
    const cell = row.insertCell();
    cell.textContent = text; cell.className = kind;
  }
  const bytes = row.insertCell();
  message.entropy.forEach((entropy, at) => {
    const bar = document.createElement("span"), flips = message.flips.slice(8 * at, 8 * at + 8);
    const stripes = flips.map((flip, bit) => {
      const share = flip ? 15 + 85 * flip / steps : 0;
      return `color-mix(in srgb, var(--accent) ${share.toFixed(1)}%, var(--soft)) ${12.5 * bit}% ${12.5 * bit + 12.5}%`;
    });
    bar.className = "byte";
    bar.style.setProperty("--bits", `linear-gradient(to right, ${stripes.join(", ")})`);
    bar.textContent = entropy.toFixed(2);
    bar.title = `byte ${at}\n${flips.map((flip, bit) => `bit ${7 - bit}: ${grouped(flip)} changes (${(100 * flip / steps).toPrecision(3)} %)`).join("\n")}`;
    bytes.append(bar);
  });
  const filter = `0x${message.idText}`;
  row.onclick = () => { document.getElementById("filter").value = filter; showTab("frames"); table_.filter(filter); };
  return row;
}
