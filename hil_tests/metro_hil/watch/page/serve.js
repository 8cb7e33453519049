"use strict";
// The page of `hil serve`: fetches the campaigns each second, and shows what the filter lets pass.

const $ = id => document.getElementById(id);
const state = { campaigns: [], seen: -1, sort: { rows: ["started", -1], cases: ["id", 1] }, open: null, cases: [] };
const SIGNS = { all: "✓", part: "!", none: "✕" };
const PERIOD_MS = 1000, COLUMNS_MOST = 60;

const element = (name, text = "", kind = "") => { const made = document.createElement(name); made.textContent = text; if (kind) made.className = kind; return made; };
const path = (file, words) => `${file}?${new URLSearchParams(words)}`;
const unitText = unit => unit === "1" ? "" : ` ${unit}`;
const numberText = value => value === null || value === undefined ? "–" : Number(value.toPrecision(4)).toString();

async function load() {
  try {
    const answer = await fetch(path("data", { seen: state.seen }));
    if (!answer.ok) throw new Error(await answer.text());
    const told = await answer.json();
    if (told.campaigns) { state.campaigns = told.campaigns; state.seen = told.version; show(); }
    $("told").textContent = summary();
  } catch (error) {
    $("told").textContent = `The server does not answer; this page tries again each second (${error.message}).`;
  }
  document.documentElement.dataset.ready = "yes";
  setTimeout(load, PERIOD_MS);
}

function summary() {
  const all = state.campaigns, running = all.filter(each => each.state === "running");
  if (!all.length) return "No campaign is in this folder yet; `hil run` makes one, and this page then shows it.";
  const failed = all.filter(each => each.state === "failed").length;
  return `${all.length} campaigns, ${failed} failed${running.length ? `, running: ${running.map(each => `${each.name} ${each.done} of ${each.cases}`).join(", ")}` : ""}`;
}

// Words that must all occur; `name:` and `state:` look at that column only.
function passing() {
  const words = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  return state.campaigns.filter(each => words.every(word => {
    const [, key, rest] = /^(name|state|program):(.*)$/.exec(word) ?? [null, null, word];
    return (key ? String(each[key]) : Object.values(each).filter(value => typeof value === "string").join(" ") + Object.keys(each.scenarios).join(" ")).toLowerCase().includes(rest);
  }));
}

function sorted(rows, table) {
  const [key, sign] = state.sort[table];
  return [...rows].sort((a, b) => { const [x, y] = [a[key] ?? "", b[key] ?? ""]; return (typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y), undefined, { numeric: true })) * sign; });
}

function heads(table, columns) {
  const row = element("tr");
  for (const [key, text, kind] of columns) {
    const cell = element("th", "", kind ?? ""), button = element("button", text);
    const [by, sign] = state.sort[table] ?? [];
    if (by === key) cell.dataset.order = sign > 0 ? "up" : "down";
    button.onclick = () => { state.sort[table] = [key, by === key ? -sign : 1]; table === "rows" ? show() : showCases(); };
    cell.append(key ? button : text); row.append(cell);
  }
  $(table).tHead.replaceChildren(row);
}

function show() {
  const shown = passing();
  heads("rows", [["state", "state"], ["name", "campaign"], ["started", "started"], ["program", "program"], ["good", "as expected", "n"], ["done", "done", "n"]]);
  $("rows").tBodies[0].replaceChildren(...sorted(shown, "rows").map(campaignRow));
  options($("name"), [...new Set(shown.map(each => each.name))].sort().map(name => [name, name]), shown.at(-1)?.name);
  const choices = [...shown].reverse().map(each => [each.path, `${each.started.slice(0, 16).replace("T", " ")} ${each.name} (${each.state})`]);
  const newest = shown.at(-1), earlier = shown.filter(each => each.name === newest?.name).at(-2);
  options($("before"), choices, earlier?.path); options($("after"), choices, newest?.path);
  history_(); margins(); compare();
  if (state.open) { const now = state.campaigns.find(each => each.path === state.open); if (now && now.done !== state.openDone) openCampaign(now); }
}

// Keeps what the user chose as long as it exists.
function options(select, choices, first) {
  const kept = select.dataset.chosen && choices.some(([value]) => value === select.dataset.chosen) ? select.dataset.chosen : first;
  select.replaceChildren(...choices.map(([value, text]) => { const made = element("option", text); made.value = value; return made; }));
  if (kept !== undefined) select.value = kept;
}

function campaignRow(each) {
  const row = element("tr");
  row.tabIndex = 0; row.classList.toggle("at", each.path === state.open);
  const badge = element("td"); badge.append(element("span", each.state, `state ${each.state}`)); row.append(badge);
  const name = element("td"); name.append(element("b", each.name), " ", element("span", each.title, "quiet"));
  if (each.problem) name.append(element("div", each.problem, "small worse"));
  if (each.subset) name.append(element("div", `subset: ${each.subset}`, "small quiet"));
  if (each.path !== ".") name.append(element("div", each.path, "small quiet"));
  for (const [id, why] of (each.failures ?? []).slice(-5)) name.append(element("div", `${id}: ${why}`, "small worse"));
  row.append(name, element("td", each.started.replace("T", " ").replace("Z", ""), "keep"), element("td", each.program, "mono"));
  row.append(element("td", each.cases ? `${each.good} of ${each.done}` : "", "n"));
  const done = element("td", "", "n");
  if (each.state === "running" || each.state === "unfinished") { const bar = element("progress"); bar.max = each.cases; bar.value = each.done; bar.ariaLabel = "cases done"; done.append(bar, ` ${each.done} of ${each.cases}`); } else done.textContent = each.cases;
  row.append(done);
  row.onclick = () => openCampaign(each);
  row.onkeydown = event => { if (event.key === "Enter") openCampaign(each); };
  return row;
}

async function openCampaign(each) {
  const fresh = state.open !== each.path;
  state.open = each.path; state.openDone = each.done;
  for (const row of $("rows").tBodies[0].rows) row.classList.remove("at");
  $("detail").hidden = false;
  $("detail-name").textContent = `${each.name}, ${each.started.replace("T", " ").replace("Z", "")}`;
  $("detail-told").textContent = each.problem ?? "Reading the cases …";
  $("cases").tBodies[0].replaceChildren();
  const answer = await fetch(path("cases", { path: each.path }));
  if (state.open !== each.path) return; // the user opened another one meanwhile
  if (!answer.ok) { $("detail-told").textContent = await answer.text(); return; }
  const cases = await answer.json();
  if (state.open !== each.path) return;
  state.cases = cases;
  $("detail-told").replaceChildren(`${each.good} of ${each.done} cases as expected, program ${each.program}. `);
  if (["passed", "failed"].includes(each.state)) { const link = element("a", "The campaign's own page"); link.href = path("report", { path: each.path }); $("detail-told").append(link); }
  if (fresh) $("detail-which").value = state.cases.some(row => !row.good) ? "bad" : "all";
  showCases();
  if (fresh) $("detail").scrollIntoView({ block: "start" });
}

function showCases() {
  const words = $("detail-filter").value.toLowerCase().split(/\s+/).filter(Boolean), bad = $("detail-which").value === "bad";
  const rows = state.cases.filter(row => (!bad || !row.good) && words.every(word => `${row.id} ${row.verdict} ${row.why} ${row.monitor}`.toLowerCase().includes(word)));
  heads("cases", [["id", "case"], ["verdict", "verdict"], ["why", "why"], ["monitor", "least margin of"], ["margin", "margin", "n"], [null, "page"]]);
  $("cases").tBodies[0].replaceChildren(...sorted(rows, "cases").slice(0, 500).map(each => {
    const row = element("tr"), page = element("td");
    row.append(element("td", each.id, "mono"), element("td", `${each.good ? "✓" : "✕"} ${each.verdict}`, each.good ? "" : "worse"), element("td", each.why ?? ""), element("td", each.monitor ?? ""), element("td", each.margin === undefined || each.margin === null ? "" : numberText(each.margin) + unitText(each.unit), "n"));
    if (each.kept) {
      const link = element("a", each.at_s === null ? "page" : `page at ${each.at_s.toFixed(1)} s`);
      const span = each.at_s === null ? "" : `#from=${(each.at_s - 8).toFixed(3)}&to=${(each.at_s + 4).toFixed(3)}&at=${each.at_s.toFixed(3)}`;
      link.href = path("case", { path: state.open, id: each.id }) + span; page.append(link);
    }
    row.append(page);
    return row;
  }));
  if (!rows.length) { const row = element("tr"), cell = element("td", bad ? "No case failed." : "No case passes the filter.", "quiet"); cell.colSpan = 6; row.append(cell); $("cases").tBodies[0].append(row); }
}

const runsOf = name => passing().filter(each => each.name === name && each.done).slice(-COLUMNS_MOST);
const kindOf = ([cases, good]) => good === cases ? "all" : good ? "part" : "none";

// A scenario is flaky if campaigns with one fingerprint, which are the same, came out differently.
function flaky(runs, scenario) {
  const seen = new Map();
  for (const run of runs) {
    const now = run.done === run.cases && run.scenarios[scenario];
    if (!now) continue;
    if (seen.has(run.fingerprint) && seen.get(run.fingerprint) !== now[1]) return true;
    seen.set(run.fingerprint, now[1]);
  }
  return false;
}

function history_() {
  const runs = runsOf($("name").value), names = [...new Set(runs.flatMap(run => Object.keys(run.scenarios)))].sort();
  $("legend").textContent = "Each column is a run of the campaign, the newest on the right. ✓ all cases are as expected, ! some are not, ✕ none is. A frame marks a change against the run before; flaky: equal campaigns came out differently.";
  const table = element("table"), head = element("tr");
  head.append(element("th", ""));
  for (const run of runs) { const cell = element("th"), text = element("span", `${run.started.slice(5, 16).replace("T", " ")} ${run.program.split("+").at(-1).slice(0, 7)}`); cell.title = `${run.path}\n${run.program}`; cell.append(text); head.append(cell); }
  table.append(head);
  for (const name of names) {
    const row = element("tr"), title = element("td", name);
    if (flaky(runs, name)) title.append(" ", element("span", "flaky", "flaky"));
    row.append(title);
    let before = null;
    for (const run of runs) {
      const now = run.scenarios[name], cell = element("td");
      if (now) {
        const share = now[1] / now[0], kind = kindOf(now), button = element("button", SIGNS[kind], `cell ${kind}`);
        if (before !== null && before !== share) button.classList.add("changed");
        before = share;
        button.title = `${name}: ${now[1]} of ${now[0]} as expected\n${run.started}\n${run.program}`;
        button.ariaLabel = button.title;
        button.onclick = () => { $("detail-filter").value = name; openCampaign(run); };
        cell.append(button);
      }
      row.append(cell);
    }
    table.append(row);
  }
  $("matrix").replaceChildren(names.length ? table : element("p", "No run of a campaign passes the filter.", "quiet"));
}

function margins() {
  const runs = runsOf($("name").value), names = [...new Set(runs.flatMap(run => Object.keys(run.margins)))].sort();
  $("curves").tHead.replaceChildren();
  $("curves").tBodies[0].replaceChildren(...names.map(name => {
    const found = runs.map((run, at) => [at, run.margins[name]?.[0], run]).filter(([, value]) => value !== undefined);
    const values = found.map(([, value]) => value), low = Math.min(0, ...values), high = Math.max(...values, low + 1e-9);
    const x = at => 6 + at / Math.max(1, runs.length - 1) * 248, y = value => 30 - (value - low) / (high - low) * 26;
    const changed = found.filter(([, value], k) => k && Math.abs(value - found[k - 1][1]) > 0.01 * (high - low));
    const [, last, run] = found.at(-1), unit = run.margins[name][1];
    const row = element("tr"), picture = element("td");
    picture.innerHTML = `<svg viewBox="0 0 260 34" role="img"><line class="zero" x1="0" x2="260" y1="${y(0)}" y2="${y(0)}"/><polyline class="curve" points="${found.map(([at, value]) => `${x(at)},${y(value)}`).join(" ")}"/>${changed.map(([at, value]) => `<circle class="point" r="3" cx="${x(at)}" cy="${y(value)}"/>`).join("")}<circle class="last" r="2.5" cx="${x(found.at(-1)[0])}" cy="${y(last)}"/></svg>`;
    const words = changed.length ? `changed ${changed.length} times, last on ${changed.at(-1)[2].started.slice(0, 16).replace("T", " ")}` : "unchanged";
    picture.firstChild.setAttribute("aria-label", `${name}: ${numberText(last)} ${unit}, ${words}`);
    row.append(element("td", name), picture, element("td", numberText(last) + unitText(unit), last < 0 ? "n worse" : "n"), element("td", run.margins[name][2], "mono"), element("td", words, "quiet"));
    return row;
  }));
}

// What differs between two campaigns, the worst change first.
function compare() {
  const find = id => state.campaigns.find(each => each.path === $(id).value), [a, b] = [find("before"), find("after")], rows = [];
  if (a && b) {
    for (const name of new Set([...Object.keys(a.scenarios), ...Object.keys(b.scenarios)])) {
      const [x, y] = [a.scenarios[name], b.scenarios[name]], text = each => each ? `${each[1]} of ${each[0]}` : "–";
      if (String(x) !== String(y)) rows.push([x && y ? y[1] / y[0] - x[1] / x[0] : 0, `scenario ${name}`, text(x), text(y), ""]);
    }
    for (const name of new Set([...Object.keys(a.margins), ...Object.keys(b.margins)])) {
      const [x, y] = [a.margins[name], b.margins[name]];
      if (x?.[0] === y?.[0]) continue;
      const by = x && y ? y[0] - x[0] : 0;
      rows.push([x && y ? by / Math.max(1e-9, Math.abs(x[0])) / 1e3 : 0, `margin of ${name}`, x ? numberText(x[0]) + unitText(x[1]) : "–", y ? numberText(y[0]) + unitText(y[1]) : "–", x && y ? `${by > 0 ? "+" : "−"}${numberText(Math.abs(by))}${unitText(y[1])}` : ""]);
    }
    rows.sort((one, other) => one[0] - other[0]);
  }
  const same = a && b && a.fingerprint && a.fingerprint === b.fingerprint ? "Both are the same campaign with the same program. " : a && b && a.name !== b.name ? "These are two different campaigns. " : "";
  $("difference-told").textContent = !a || !b ? "Two campaigns are needed." : same + (rows.length ? `${rows.length} differences, the worst first.` : "Nothing differs in outcomes and margins.");
  const head = element("tr"); for (const text of ["what", "before", "after", "change"]) head.append(element("th", text));
  $("difference").tHead.replaceChildren(...(rows.length ? [head] : []));
  $("difference").tBodies[0].replaceChildren(...rows.map(([by, what, x, y, change]) => {
    const row = element("tr");
    row.append(element("td", what), element("td", x), element("td", y), element("td", change || (by < 0 ? "worse" : by > 0 ? "better" : ""), by < 0 ? "worse" : by > 0 ? "better" : ""));
    return row;
  }));
}

$("root").textContent = ROOT;
$("filter").oninput = show;
$("detail-filter").oninput = $("detail-which").onchange = showCases;
for (const id of ["name", "before", "after"]) $(id).onchange = () => { $(id).dataset.chosen = $(id).value; id === "name" ? (history_(), margins()) : compare(); };
document.addEventListener("keydown", event => {
  if (event.target.closest("input, select") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "/") { event.preventDefault(); $("filter").focus(); }
});
load();
