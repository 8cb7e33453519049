"use strict";
// The page of `vobc line --web`: one WebSocket brings the state of the line ten times a second.

const $ = id => document.getElementById(id);
const RETRY_MS = 1000, SAMPLES_MOST = 1800, EVENTS_MOST = 500, GAP_S = 5, NEW_TERM_MS = 8000, BACK_M = 100;
const FIELDS = { "switch-master": ["area", "train"], "remove-train": ["train"], restrict: ["stretch", "limit", "end"], close: ["stretch", "end"] };
const page = { head: null, state: null, now: 0, busy: "", samples: [], events: [], terms: new Map(), changed: new Map() };
let socket = null;

const element = (name, text = "", kind = "") => { const made = document.createElement(name); made.textContent = text; if (kind) made.className = kind; return made; };
const safe = text => String(text).replace(/[&<>"]/g, sign => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[sign]);
const clockText = at => page.head.of_run ? `${Math.floor(at / 60)}:${String(Math.floor(at % 60)).padStart(2, "0")}` : new Date(at * 1000).toLocaleTimeString([], { hour12: false });
const millis = value => value === null ? "–" : value.toFixed(0);
const colour = train => `c${train % 6}`;

function connect() {
  if (!("WebSocket" in window)) { $("told").textContent = "This browser has no WebSocket; `vobc line --watch` shows the line in a terminal."; return; }
  socket = new WebSocket(`${location.href.split("#")[0].replace(/^http/, "ws")}stream`);
  socket.onmessage = event => { const told = JSON.parse(event.data); told.kind === "lost" ? socket.close() : take(told); };
  socket.onclose = () => {
    $("told").textContent = "The connection to the server of this page is lost; the page tries again each second. What it shows is old.";
    $("told").className = "loud";
    setTimeout(connect, RETRY_MS);
  };
}

function take(told) {
  if (told.kind === "snapshot") { Object.assign(page, { head: told, samples: [], events: [], terms: new Map(), changed: new Map() }); begin(); }
  Object.assign(page, { state: told.state, now: told.now, busy: told.busy, remark: told.remark, ended: told.ended });
  page.samples.push(...told.samples ?? []); page.samples.splice(0, page.samples.length - SAMPLES_MOST);
  const fresh = told.events ?? [];
  page.events.push(...fresh); page.events.splice(0, page.events.length - EVENTS_MOST);
  for (const area of page.state.areas) {
    if (page.terms.has(area.area) && page.terms.get(area.area) !== area.term) page.changed.set(area.area, performance.now());
    page.terms.set(area.area, area.term);
  }
  summary(); areas(); track(); trains(); results(told.results ?? []);
  if (told.samples || told.kind === "snapshot") graph();
  if (fresh.length || told.kind === "snapshot") events();
  if (told.kind === "news") for (const each of fresh) if (each.kind !== "line") { $("answer").textContent = each.text; $("answer").className = each.kind; }
  if (page.busy) { $("answer").textContent = `${page.busy}: sent, waiting for the answer …`; $("answer").className = "quiet"; }
  $("command").querySelector("button").disabled = Boolean(page.busy);
  document.documentElement.dataset.ready = "yes";
}

function begin() {
  const head = page.head;
  document.title = `Line ${head.line}`; $("line").textContent = head.line;
  const verbs = Object.keys(head.commands);
  $("commanding").hidden = !verbs.length;
  if (head.of_run) $("minutes").value = "30";
  if ($("verb").options.length !== verbs.length) $("verb").replaceChildren(...verbs.map(verb => element("option", verb)));
  $("area").replaceChildren(...head.areas.map(([number]) => element("option", number)));
  if (verbs.length) fields();
}

function summary() {
  const { state } = page, silent = state.trains.filter(train => train.silence).length;
  const lost = state.connected ? "" : "There is no session with the line: is its wayside up? The page goes on when it is back.";
  const wrong = page.remark || lost || (page.ended ? "" : state.track.wayside);
  const orders = [...state.track.restrictions.map(([a, b, limit]) => `at most ${limit.toFixed(0)} km/h from ${a} to ${b} m`), ...state.track.closed.map(([a, b]) => `closed from ${a} to ${b} m`)];
  const words = [`${state.trains.length} train${state.trains.length === 1 ? "" : "s"}${silent ? `, ${silent} silent` : ""}`, clockText(page.now), ...orders, ...[wrong, page.ended].filter(Boolean), page.ended ? "report" : page.head.commands.hold ? "commands allowed" : "read-only"];
  $("told").textContent = words.join(" · "); $("told").className = wrong || silent ? "loud" : "";
}

function areas() {
  const shown = page.state.areas.map(area => {
    const card = element("div", "", "area"), title = element("div", `Area ${area.area} `);
    title.append(element("b", area.master ? `T${area.master}` : "no master"));
    card.append(title);
    if (!area.master) { card.classList.add("none"); return card; }
    card.classList.toggle("silent", Boolean(area.silence));
    const at = page.changed.get(area.area), isNew = at !== undefined && performance.now() - at < NEW_TERM_MS;
    card.classList.toggle("new", !area.silence && (isNew || !area.issuing));
    card.append(element("div", area.silence || `${area.issuing ? "commands" : "takes over"}, term ${area.term}, age ${area.age_s.toFixed(1)} s`));
    card.append(element("div", area.standby ? `standby T${area.standby}` : "no standby"));
    if (area.why) card.append(element("div", area.why, "quiet small"));
    return card;
  });
  $("areas").replaceChildren(...shown);
}

// Labels that would cover the one before are left out; the mark stays.
function labels(places, width, room) {
  let free = -1e9;
  return places.map(([x, text]) => {
    const half = text.length * 3.1 + room, at = Math.min(Math.max(x, half), width - half);
    if (at - half < free) return "";
    free = at + half;
    return `<text class="tick" text-anchor="middle" x="${at}" y="0">${safe(text)}</text>`;
  });
}

function track() {
  const { head, state } = page, [low, high] = head.span, width = Math.max(240, $("track").clientWidth), lane = 34, top = 62;
  const x = at => Math.min(Math.max((at - low) / (high - low), 0), 1) * width, size = state.trains.length * lane, bottom = top + size + 6;
  const stretch = (kind, a, b, text) => `<rect class="${kind}" x="${x(a)}" y="22" width="${Math.max(2, x(b) - x(a))}" height="${bottom - 22}"><title>${safe(text)}</title></rect>`;
  const parts = head.areas.map(([number, a, b]) => {
    const area = state.areas.find(each => each.area === number), master = area?.master ? `T${area.master}` : "–";
    const text = x(b) - x(a) > 190 && area?.master ? `area ${number}: ${master}, term ${area.term}${area.silence ? ", silent" : ""}` : `${number}: ${master}${area?.silence ? " ✕" : ""}`;
    return `<rect class="area-band" x="${x(a)}" y="0" width="${x(b) - x(a)}" height="20"/><text x="${(x(a) + x(b)) / 2}" y="14" text-anchor="middle">${safe(text)}</text>`;
  });
  const names = labels(head.stations.map(([name, at]) => [x(at), name]), width, 3);
  head.stations.forEach(([name, at], k) => { parts.push(`<line class="station" x1="${x(at)}" x2="${x(at)}" y1="48" y2="${bottom}"><title>${safe(name)}</title></line><g transform="translate(0,37)">${names[k]}</g>`); });
  parts.push(`<line class="track" x1="0" x2="${width}" y1="48" y2="48"/>`);
  for (const [number, kind, a, b] of head.objects) {
    const told = state.track.objects.find(each => each[0] === number)?.[1] ?? "not received";
    parts.push(`<rect class="object" x="${x((a + b) / 2) - 4}" y="44" width="8" height="8"><title>${safe(`${kind} ${number}: ${told}`)}</title></rect>`);
  }
  for (const [a, b, limit] of state.track.restrictions) parts.push(stretch("limited", a, b, `at most ${limit.toFixed(0)} km/h from ${a} to ${b} m`));
  for (const [a, b] of state.track.closed) parts.push(stretch("closed", a, b, `closed from ${a} to ${b} m`));
  state.trains.forEach((train, k) => {
    const y = top + k * lane, front = x(train.front_max_m), rear = Math.min(x(train.rear_min_m), front - 5);
    const what = train.silence ? "silent" : !train.localised ? "place unknown" : `${train.speed_kmh.toFixed(0)} km/h${train.emergency ? " EMERGENCY" : ""}`;
    const text = `T${train.train} ${what}`, half = text.length * 3.1 + 2, middle = Math.min(Math.max(front, half), width - half);
    let row = `<text class="tick strong" text-anchor="middle" x="${middle}" y="${y + 12}">${safe(text)}</text>`;
    if (train.localised && !train.silence && train.authority_m !== null) {
      const end = x(train.authority_m);
      row += `<rect class="authority own" x="${front}" y="${y + 18}" width="${Math.max(0, end - front)}" height="8"/><line class="reach line" x1="${end}" x2="${end}" y1="${y + 15}" y2="${y + 29}"/>`;
    }
    if (train.localised) row += `<rect class="body ${train.silence ? "silent" : "own"}" x="${rear}" y="${y + 16}" width="${front - rear}" height="12"><title>${safe(`${text}, front ${train.front_max_m.toFixed(1)} m, ${train.what}`)}</title></rect>`;
    parts.push(`<g class="${colour(train.train)}">${row}</g>`);
  });
  $("track").innerHTML = `<svg role="img" aria-label="Trains on the line" width="${width}" height="${bottom}" viewBox="0 0 ${width} ${bottom}">${parts.join("")}</svg>`;
}

function trains() {
  const rows = page.state.trains.map(train => {
    const row = element("tr"), silent = Boolean(train.silence), hidden = silent || !train.localised;
    row.classList.toggle("silent", silent);
    const end = hidden || train.authority_m === null ? null : train.authority_m;
    const cells = [hidden ? "–" : train.front_max_m.toFixed(1), silent ? "–" : train.speed_kmh.toFixed(1), end === null ? "–" : end.toFixed(1), end === null ? "–" : (end - train.front_max_m).toFixed(0), train.area, train.term, train.age_s.toFixed(2), silent ? "–" : millis(train.latency_ms), millis(train.latency_max_ms)];
    row.append(element("td", `T${train.train}`), ...cells.map(text => element("td", text, "n")));
    row.append(element("td", silent ? `${train.silence}, last at ${train.front_max_m.toFixed(1)} m` : train.what, train.emergency ? "loud" : ""));
    return row;
  });
  $("trains").tBodies[0].replaceChildren(...rows);
  $("unseen").replaceChildren(...page.state.unseen.map(text => element("p", text, "loud")));
  const known = page.state.trains.map(train => train.train).sort((a, b) => a - b);
  if ($("known").dataset.of !== String(known)) {
    $("known").dataset.of = known;
    $("known").replaceChildren(...known.map(number => { const made = element("option"); made.value = number; return made; }));
  }
}

// What the run measured, once it has ended.
function results(measured) {
  $("measured").hidden = !measured.length;
  $("results").tBodies[0].replaceChildren(...measured.map(train => {
    const row = element("tr"), struck = train.struck ? "struck by a fault" : "none";
    const cells = [train.least_gap_m === null ? "–" : train.least_gap_m.toFixed(1), millis(train.latency_p50_ms), millis(train.latency_p99_ms), millis(train.oldest_ms), train.service_brakes];
    row.append(element("td", `T${train.train}`), ...cells.map(text => element("td", text, "n")));
    row.append(element("td", train.emergencies.map(each => each.cause).join(", ") || struck));
    row.append(element("td", train.stops.map(stop => `${stop.station} ${stop.error_m < 0 ? "" : "+"}${stop.error_m.toFixed(2)} m`).join(", ")));
    return row;
  }));
}

function graph() {
  const { head, samples } = page, most = 60 * $("minutes").value, span = head.of_run ? Math.min(most, Math.max(30, page.now)) : most, width = Math.max(240, $("graph").clientWidth), height = 380, left = 34, foot = 20;
  const end = page.now, begin = end - span, [low, high] = head.span;
  const x = at => left + (at - begin) / span * (width - left - 26), y = at => (height - foot) * (1 - (at - low) / (high - low)) + 4;
  const parts = [];
  let free = 1e9;
  for (const [name, at] of head.stations) {
    parts.push(`<line class="grid" x1="${left}" x2="${width}" y1="${y(at)}" y2="${y(at)}"/>`);
    if (y(at) < free - 12) { parts.push(`<text class="tick" x="0" y="${y(at) + 4}">${safe(name.slice(0, 5))}</text>`); free = y(at); }
  }
  for (const [, a] of head.areas.slice(1)) parts.push(`<line class="axis" stroke-dasharray="2 4" x1="${left}" x2="${width}" y1="${y(a)}" y2="${y(a)}"><title>border of areas</title></line>`);
  const step = span / (width < 500 ? 2 : 5);
  for (let at = Math.ceil((head.of_run ? Math.max(0, begin) : begin) / step) * step; at <= end; at += step) parts.push(`<line class="grid" x1="${x(at)}" x2="${x(at)}" y1="4" y2="${height - foot + 4}"/><text class="tick" text-anchor="middle" x="${Math.min(Math.max(x(at), left + 22), width - 24)}" y="${height - 1}">${clockText(at)}</text>`);
  const paths = new Map();
  for (const [at, places] of samples) {
    if (at < begin) continue;
    for (const [train, front] of places) {
      const path = paths.get(train) ?? { text: "", at: -1e9, front };
      const cut = at - path.at > GAP_S || front < path.front - BACK_M;
      path.text += `${cut ? "M" : "L"}${x(at).toFixed(1)} ${y(front).toFixed(1)}`;
      Object.assign(path, { at, front }); paths.set(train, path);
    }
  }
  for (const [train, path] of paths) parts.push(`<g class="${colour(train)}"><path class="path line" d="${path.text}"/><text class="tick strong" x="${x(path.at) + 3}" y="${y(path.front) + 4}">T${train}</text></g>`);
  for (const each of page.events) if (each.at >= begin && /^area .* after train /.test(each.text)) parts.push(`<line class="zero" x1="${x(each.at)}" x2="${x(each.at)}" y1="4" y2="${height - foot + 4}"><title>${safe(each.text)}</title></line>`);
  $("graph").innerHTML = `<svg role="img" aria-label="Places of the trains over time" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}">${parts.join("")}</svg>`;
}

function events() {
  $("events").replaceChildren(...[...page.events].reverse().map(each => { const row = element("p", "", each.kind); row.append(element("span", clockText(each.at), "mono"), each.text); return row; }));
}

// Commands.

const fieldsOf = verb => FIELDS[verb] ?? ["train", "end"];

function fields() {
  const verb = $("verb").value, shown = fieldsOf(verb), back = shown.includes("end") && $("end").checked;
  for (const label of $("command").querySelectorAll("[data-of]")) {
    label.hidden = !shown.includes(label.dataset.of) || (label.dataset.of === "limit" && back);
    for (const input of label.querySelectorAll("input, select")) input.disabled = label.hidden;
  }
  $("meaning").textContent = `${page.head.commands[verb]}${back ? " — taken back" : ""}`;
}

function command() {
  const verb = $("verb").value, shown = fieldsOf(verb), made = { verb };
  if (shown.includes("area")) made.area = Number($("area").value);
  if (shown.includes("train")) made.train = Number($("train").value);
  if (shown.includes("stretch")) Object.assign(made, { start_m: Number($("start").value), end_m: Number($("to").value) });
  if (shown.includes("end")) made.end = $("end").checked;
  if (shown.includes("limit") && !made.end) made.limit_kmh = Number($("limit").value);
  return made;
}

function commandText(made) {
  const words = ["vobc", made.verb];
  if (made.area) words.push("--area", made.area, "--to");
  if (made.train) words.push(`T${made.train}`);
  if (made.start_m !== undefined) words.push(made.start_m, made.end_m);
  if (made.limit_kmh !== undefined) words.push("--limit", made.limit_kmh);
  if (made.end) words.push("--end");
  return words.join(" ");
}

$("command").onsubmit = event => {
  event.preventDefault();
  const made = command();
  $("asked").textContent = commandText(made); $("does").textContent = $("meaning").textContent;
  $("yes").onclick = () => { $("confirm").close(); socket.send(JSON.stringify(made)); };
  $("confirm").showModal();
};
$("no").onclick = () => $("confirm").close();
$("verb").onchange = () => { $("end").checked = false; fields(); };
$("end").onchange = fields;
$("minutes").onchange = graph;
addEventListener("resize", () => { if (page.state) { track(); graph(); } });
connect();
