// Starts the page: reads its data, lays out the panels, and handles keys.

const KEYS = [
  ["← →", "cursor to the frame before or after; with Shift ten frames"], ["[ ]", "to the event before or after"],
  ["+ −", "zoom in or out about the cursor"], ["a d", "pan"], ["0", "whole log"], ["Backspace", "back to the span before"],
  ["Home End", "to the first or last frame"], ["Enter", "pin the cursor where it is"], ["Esc", "let the cursor go"], ["f", "filter the frames"], ["s", "add a signal"],
  ["1 2 3 4 5", "frames, events, messages, bits, faults"], ["Space", "pause or resume a live page"], ["j", "show or hide speed over distance"], ["t", "light or dark"], ["g", "go to an instant"], ["?", "this list"],
];
const POINTER = [
  ["wheel", "zoom"], ["Shift+wheel, drag", "pan"], ["Shift+drag", "zoom to a span"], ["click", "pin the cursor; the way to the pointer is shown then"],
  ["double click", "whole log"], ["Alt+wheel", "scroll the panels"],
];
const $ = id => document.getElementById(id);
let panels = [], overview, table_, journey = null, drive;

async function start() {
  setTheme(localTheme());
  const head = view.head = JSON.parse($("head").textContent);
  Object.assign(view, prepare(head));
  [view.first, view.last] = head.span;
  if (view.last <= view.first) view.last = view.first + 1e6;
  view.from = view.first; view.to = view.last;
  view.panels = head.panels;
  document.documentElement.classList.toggle("no-cycles", !head.cycles);
  const packed = $("block").textContent;
  $("block").remove();
  const bytes = head.remote ? await fetch("block").then(answer => answer.arrayBuffer()).then(got => inflateBytes(new Uint8Array(got))) : await inflate(packed);
  const block = new Block(bytes, head.block);
  view.source = head.live ? new LiveSource(head) : head.remote ? new RemoteSource(head) : new LocalSource(head, block);
  recall();
  table_ = new FrameTable();
  overview = new Overview($("overview").querySelector("canvas"));
  drive = new Drive($("drive"));
  if (head.journey) journey = new Journey($("journey"), head.journey, block);
  showWarnings(head);
  showFacts();
  listen();
  layPanels();
  journey?.key();
  drawAll();
  performance.mark("drawn");
  await table_.filter("");
  eventList();
  statsList();
  document.documentElement.dataset.ready = "yes";
  performance.mark("ready");
  if (head.live) startLive();
}

function layPanels() {
  panels = view.panels.map((names, number) => new Panel(names, number));
  fitMargin(panels);
  $("panels").replaceChildren(...panels.map(panel => panel.element));
  if (!panels.length) $("panels").innerHTML = '<div class="panel empty">No signal chosen: press <kbd>s</kbd> to add one.</div>';
  for (const panel of panels) {
    panel.element.querySelector('[data-do="gone"]').onclick = () => changePanels(all => all.filter((_, at) => at !== panel.number));
    panel.element.querySelector('[data-do="up"]').onclick = () => changePanels(all => {
      const next = [...all], at = panel.number;
      if (at > 0) [next[at - 1], next[at]] = [next[at], next[at - 1]];
      return next;
    });
  }
}
function changePanels(change) { view.panels = change(view.panels).filter(panel => panel.length); layPanels(); soon("panels"); }
function removeSignal(number, name) { changePanels(all => all.map((panel, at) => at === number ? panel.filter(each => each !== name) : panel)); }

// The line plots share the height that the state bands leave, within legible limits.
function fitPanels() {
  const lines = panels.filter(panel => panel.lines.length).length || 1;
  const taken = panels.reduce((sum, panel) => sum + HEAD + BAND * panel.states.length + (panel.lines.length ? 0 : TOP), 0);
  const line = Math.min(Math.max(Math.floor(($("panels").clientHeight - taken) / lines), LINE_LEAST), LINE_MOST);
  panels.forEach(panel => panel.fit(line));
}

function drawAll() {
  fitPanels();
  for (const panel of panels) panel.refresh();
  drawAxis($("axis").querySelector("canvas"));
  overview.refresh();
  journey?.draw();
  drive.draw();
}

function drawCursor() {
  for (const panel of panels) if (panel.visible()) panel.draw();
  drawAxis($("axis").querySelector("canvas"));
  overview.draw();
  journey?.draw();
  drive.draw();
  table_.follow();
  followEvents();
  showValues();
}

let asking = 0;
async function showValues() {
  const t = view.hover ?? view.cursor, mine = ++asking;
  const signals = panels.flatMap(panel => panel.signals);
  const readout = $("readout");
  if (t === null) { readout.textContent = ""; panels.forEach(panel => panel.shown.forEach(each => { each.textContent = ""; })); return; }
  const date = dateText(t), pinned = view.pinned && view.hover !== null;
  readout.innerHTML = "<b></b><br><span></span>";
  readout.firstChild.textContent = `${timeText(t, 6)} s`;
  readout.lastChild.textContent = pinned ? `${spanText(view.hover - view.cursor)} from the pinned cursor` : date || (view.pinned ? "pinned" : `span ${spanText(view.to - view.from)}`);
  const values = await view.source.values(signals, t);
  if (mine !== asking) return;
  let at = 0;
  for (const panel of panels) for (const shown of panel.shown) {
    const signal = signals[at], value = values[at++];
    const raw = signal.state ? Math.round((value - signal.offset) / signal.scale) : undefined;
    const text = Number.isNaN(value) ? "–" : valueText(signal, value, raw);
    shown.textContent = signal.state || !signal.unit || signal.unit === "1" ? text : `${text} ${signal.unit}`;
  }
}

function showFacts() {
  const { head } = view, buses = head.frames.channels.length;
  $("facts").textContent = [
    `${grouped(head.frames.count)} frames`, `${head.messages.filter(message => !message.kind && (!live.on || view.source.groups[message.number]?.count)).length} messages`, spanText(head.span[1] - head.span[0]),
    buses > 1 ? `${buses} buses` : head.frames.channels[0], head.date ? `from ${head.date.slice(0, 19)} UTC` : "",
    head.inOrder ? "" : "put in order of time",
  ].filter(Boolean).join(" · ");
}

function showWarnings(head) {
  if (!head.warnings.length) return;
  $("warnings").hidden = false;
  $("warnings").replaceChildren(...head.warnings.map(text => { const line = document.createElement("p"); line.textContent = text; return line; }));
}
function complain(error) { $("warnings").hidden = false; $("warnings").textContent = `The server does not answer: ${error.message}`; }

function localTheme() {
  try { const kept = localStorage.getItem("canlog-theme"); if (kept) return kept; } catch { /* pages opened from a file may have no storage */ }
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}
function setTheme(theme) { document.documentElement.dataset.theme = theme; readColors(); }
function toggleTheme() {
  const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  setTheme(theme);
  try { localStorage.setItem("canlog-theme", theme); } catch { /* the theme is not kept */ }
  tell("theme");
}

function listen() {
  view.listeners.span.push(drawAll, () => { $("back").disabled = !view.spans.length; }, showValues);
  view.listeners.cursor.push(drawCursor);
  view.listeners.panels.push(drawAll, showValues);
  view.listeners.theme.push(() => { panels.forEach(panel => panel.chips()); journey?.key(); drawAll(); showValues(); });
  $("reset").onclick = wholeSpan; $("back").onclick = backSpan; $("theme").onclick = toggleTheme;
  $("pick").onclick = openPicker; $("keys").onclick = showHelp;
  for (const button of document.querySelectorAll("#dock [data-tab]")) button.onclick = () => showTab(button.dataset.tab);
  let typing = 0;
  $("filter").oninput = () => { clearTimeout(typing); typing = setTimeout(() => table_.filter($("filter").value), 120); };
  $("panels").addEventListener("scroll", () => panels.forEach(panel => { if (panel.stale) panel.refresh(); else if (panel.visible()) panel.draw(); }));
  new ResizeObserver(() => requestAnimationFrame(drawAll)).observe($("views"));
  document.addEventListener("keydown", onKey);
  dragGrip();
  preparePicker();
}

function onKey(event) {
  if (live.on && deskKey(event)) return;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.closest("input, select, summary, dialog")) { if (event.key === "Escape" && event.target.id === "filter") { event.preventDefault(); event.target.blur(); } return; }
  const about = view.cursor ?? (view.from + view.to) / 2, many = event.shiftKey ? 10 : 1;
  const actions = {
    ArrowLeft: () => table_.step(-many), ArrowRight: () => table_.step(many), ArrowUp: () => table_.step(-many), ArrowDown: () => table_.step(many),
    PageUp: () => table_.scroll(table_.first - table_.room + 1), PageDown: () => table_.scroll(table_.first + table_.room - 1),
    "+": () => zoom(0.6, about), "=": () => zoom(0.6, about), "-": () => zoom(1 / 0.6, about), a: () => pan(-0.2), d: () => pan(0.2),
    0: wholeSpan, Backspace: backSpan, Home: () => goTo(view.first), End: () => goTo(view.last),
    "[": () => nextEvent(-1), "]": () => nextEvent(1), Enter: () => setCursor(about, true), Escape: unpin,
    f: () => { showTab("frames"); $("filter").focus(); }, s: openPicker, t: toggleTheme, "?": showHelp,
    1: () => showTab("frames"), 2: () => showTab("events"), 3: () => showTab("stats"), 4: () => showTab("bits"), 5: () => { if (view.head.faults) showTab("faults"); },
    " ": () => { if (live.on) toggleFollow(); },
    j: () => { if (journey) { $("journey").hidden = !$("journey").hidden; drawAll(); } },
    g: () => { const text = prompt("Go to which second?"); if (text !== null && text.trim() && !Number.isNaN(Number(text))) goTo(Number(text) * NS); },
  };
  const action = actions[event.key];
  if (!action || (event.key === "Enter" && event.target.closest("button, tr")) || (event.key === " " && (!live.on || event.target.closest("button")))) return;
  event.preventDefault();
  action();
}

function dragGrip() {
  const grip = $("grip"), dock = $("dock");
  const resize = height => { dock.style.height = `${Math.min(Math.max(height, 90), innerHeight - 220)}px`; };
  grip.addEventListener("pointerdown", event => grip.setPointerCapture(event.pointerId));
  grip.addEventListener("pointermove", event => { if (event.buttons) resize(innerHeight - event.clientY); });
  grip.addEventListener("keydown", event => {
    const by = { ArrowUp: 24, ArrowDown: -24 }[event.key];
    if (by) { event.stopPropagation(); resize(dock.clientHeight + by); }
  });
}

function showHelp() {
  const rows = list => list.map(([key, what]) => `<tr><td>${key.split(" ").map(each => /^[a-z]{3,}|,/i.test(each) && list === POINTER ? each : `<kbd>${each}</kbd>`).join(" ")}</td><td>${what}</td></tr>`).join("");
  $("help").innerHTML = `<h2>Keys</h2><table>${rows(KEYS)}</table><h2 style="margin-top:14px">On the plots</h2><table>${rows(POINTER)}</table>`;
  $("help").showModal();
  $("help").onclick = () => $("help").close();
}

globalThis.canlog = { view, live, goTo, setSpan, setCursor, changePanels, decodedTexts };
start().catch(error => {
  document.documentElement.dataset.ready = "failed";
  $("warnings").hidden = false;
  $("warnings").textContent = `This page cannot be shown: ${error.message}`;
  throw error;
});
