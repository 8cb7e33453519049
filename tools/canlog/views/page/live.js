// The live page: appends the frames of the stream to the source, and follows the newest one.

const LIVE_SPAN = 30e9; // ns that are shown while the page follows
const LIVE_FRAMES = 620e3; // about half an hour of the train's bus; beyond it the older half is dropped
const LIVE_EVENTS = 5000;
const SLOW_MS = 500; // time between two updates of tables and overview
const AGAIN_MS = 1000; // time before the next try to connect
const EMPTY = new Float64Array(0);

// A typed array that grows.
class Grow {
  constructor(Type) { this.Type = Type; this.room = new Type(256); this.length = 0; }
  push(value) {
    if (this.length === this.room.length) { const wider = new this.Type(2 * this.length); wider.set(this.room); this.room = wider; }
    this.room[this.length++] = value;
  }
  get view() { return this.room.subarray(0, this.length); }
  drop(count) { this.room = this.room.slice(count, this.length); this.length -= count; if (!this.room.length) this.room = new this.Type(256); }
}

class LiveSource extends LocalSource {
  constructor(head) {
    super(head, null);
    this.grown = { t: new Grow(Float64Array), group: new Grow(Uint16Array), flags: new Grow(Uint8Array), channel: new Grow(Uint8Array), rank: new Grow(Uint32Array) };
    this.groups = []; this.verdict = this.cycle = null; this.count = 0;
    this.share();
  }

  share() { for (const [name, column] of Object.entries(this.grown)) this[name] = column.view; this.count = this.grown.t.length; this.head.frames.count = this.count; }

  groupOf(number) {
    return this.groups[number] ??= { count: 0, rowsGrown: new Grow(Uint32Array), lengthsGrown: new Grow(Uint8Array), bytesGrown: [], rows: new Uint32Array(0), lengths: new Uint8Array(0), bytes: [] };
  }

  // Appends one binary message: number of frames, bytes a frame, then columns.
  append(buffer) {
    const [n, width] = new Uint32Array(buffer, 0, 2), touched = new Set();
    let at = 16;
    const t = new Float64Array(buffer, at, n); at += 8 * n;
    const numbers = new Uint16Array(buffer, at, n); at += 2 * n;
    const flags = new Uint8Array(buffer, at, n); at += n;
    const channel = new Uint8Array(buffer, at, n); at += n;
    const lengths = new Uint8Array(buffer, at, n); at += n;
    const data = new Uint8Array(buffer, at, n * width);
    const { grown } = this;
    let last = grown.t.length ? grown.t.room[grown.t.length - 1] : -Infinity;
    for (let i = 0; i < n; i++) {
      const group = this.groupOf(numbers[i]), remote = flags[i] & REMOTE_FLAG;
      touched.add(group);
      group.rowsGrown.push(grown.t.length); group.lengthsGrown.push(lengths[i]);
      grown.rank.push(group.count++);
      last = Math.max(last, t[i]); // stamps that run backwards by a few microseconds keep the order of arrival
      grown.t.push(last); grown.group.push(numbers[i]); grown.flags.push(flags[i]); grown.channel.push(channel[i]);
      if (remote) continue;
      for (let k = group.bytesGrown.length; k < lengths[i]; k++) { const column = new Grow(Uint8Array); for (let past = 1; past < group.count; past++) column.push(0); group.bytesGrown.push(column); }
      group.bytesGrown.forEach((column, k) => column.push(k < lengths[i] ? data[i * width + k] : 0));
    }
    for (const group of touched) this.shareGroup(group);
    this.share();
    if (this.count > live.most) this.forget(this.count >> 1);
  }

  shareGroup(group) { group.rows = group.rowsGrown.view; group.lengths = group.lengthsGrown.view; group.bytes = group.bytesGrown.map(column => column.view); }

  // Drops the oldest frames, so that memory stays constant.
  forget(cut) {
    const dropped = this.groups.map(group => lowerBound(group.rows, cut));
    this.groups.forEach((group, number) => {
      for (const column of [group.rowsGrown, group.lengthsGrown, ...group.bytesGrown]) column.drop(dropped[number]);
      group.count -= dropped[number];
      this.shareGroup(group);
      for (let i = 0; i < group.rows.length; i++) group.rows[i] -= cut;
    });
    for (const column of Object.values(this.grown)) column.drop(cut);
    this.share();
    for (let i = 0; i < this.count; i++) this.rank[i] -= dropped[this.group[i]];
    this.traces.clear();
  }

  trace(signal) {
    const group = this.groups[signal.message.number];
    let kept = this.traces.get(signal.full);
    if (!kept) this.traces.set(signal.full, kept = { done: 0, t: new Grow(Float64Array), v: new Grow(Float64Array), trace: new Trace(EMPTY, EMPTY) });
    if (!group || kept.done === group.count) return kept.trace;
    const from = kept.done, piece = { count: group.count - from, lengths: group.lengths.subarray(from), bytes: group.bytes.map(column => column.subarray(from)) };
    const { values, mask } = signalColumn(signal.message, piece, signal);
    for (let i = 0; i < piece.count; i++) if (!mask || mask[i]) { kept.t.push(this.t[group.rows[from + i]]); kept.v.push(values[i]); }
    kept.done = group.count;
    return kept.trace = new Trace(kept.t.view, kept.v.view);
  }

  // A selection may be older than the frames: it ends where they end.
  rows(selection, first, count) {
    const rows = selection.rows && selection.rows.filter(row => row < this.count);
    return super.rows({ rows, count: rows ? rows.length : Math.min(selection.count, this.count) }, first, count);
  }
  rowAt(selection, t) { return Math.min(super.rowAt(selection, t), this.count - 1); }

  passing(terms, message, number) { return this.groups[number] ? super.passing(terms, message, number) : false; }
}

const live = { most: LIVE_FRAMES, on: false, following: true, ended: false, span: LIVE_SPAN, socket: null, remark: "", tries: 0, waiting: false, slow: 0, holder: "", controls: "" };

function startLive() {
  live.on = true;
  document.documentElement.classList.add("live");
  $("follow").hidden = false;
  $("follow").onclick = toggleFollow;
  showLive();
  if (view.head.desk || view.head.faults) startDesk();
  if (view.head.faults) startFaults();
  if (!("WebSocket" in globalThis)) { say("This browser has no WebSocket, so it cannot follow a run; `canlog report` writes the page as a file."); return; }
  connect();
}

function connect() {
  const address = new URL("stream", location.href.split("#")[0]);
  address.protocol = "ws:";
  const socket = live.socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => { if (typeof data === "string") heard(JSON.parse(data)); else { view.source.append(data); busEvents(); arrived(); } };
  socket.onclose = () => {
    if (live.ended) return;
    live.holder = ""; showDesk();
    say("The connection to the bench is lost; this page tries again each second.");
    setTimeout(connect, AGAIN_MS);
  };
}

function heard(told) {
  if (told.kind === "desk") { live.holder = told.holder; showDesk(); return; }
  if (told.kind === "faults") { showBegun(told.began); return; }
  if (told.kind === "refused") { $("fault-refused").textContent = told.why; return; }
  if (told.kind === "lost") { say(`This browser was too slow: ${told.messages} updates are missing here. The log of the run has them.`); return; }
  if (told.kind === "snapshot") {
    if (told.version !== view.head.live) { live.ended = true; live.socket.close(); say("The bench has another version than this page: load the page again."); return; }
    view.head.messages = []; view.head.events = []; faults.told.clear();
    view.source = new LiveSource(view.head);
    live.eventRow = 0;
    journey?.empty();
    say("");
  }
  if (told.zero) { view.head.zero = told.zero; view.head.date = BigInt(told.zero) > 0n ? new Date(Number(BigInt(told.zero) / 1000000n)).toISOString().replace("T", " ") : ""; }
  if (told.messages?.length) { view.head.messages.push(...told.messages); Object.assign(view, prepare(view.head)); }
  if (told.kind === "snapshot") layPanels();
  if (told.events) { view.head.events.push(...told.events); view.head.events.splice(0, view.head.events.length - LIVE_EVENTS); live.slow = 0; }
  if ("remark" in told) say(told.remark);
  if (told.ended) ended();
  arrived();
}

// A bus has no file of events: the controller's event frames stand for it.
function busEvents() {
  const message = view.head.eventsOnBus && view.head.messages.find(each => each.name === "VOBC_EVENT"), group = message && view.source.groups[message.number];
  if (!group) return;
  for (live.eventRow = Math.min(live.eventRow, group.count); live.eventRow < group.count; live.eventRow++) {
    const row = view.source.row(group.rows[live.eventRow]), told = decodedTexts(message, row.data);
    const kind = told.find(([name]) => name === "event")?.[1] ?? "EVENT";
    view.head.events.push({ t: row.t, kind, words: told.filter(([name]) => name !== "event").map(each => each.join(" ")).join(", "), weight: 0, basis: [] });
  }
}

function ended() {
  live.ended = true; live.holder = ""; showDesk();
  showLive();
  // The report of the whole run is at the same address; a paused viewer decides when to load it.
  if (live.following) report();
}
function report() { history.replaceState(null, "", location.pathname); location.reload(); }

function arrived() {
  if (live.waiting) return;
  live.waiting = true;
  requestAnimationFrame(() => { live.waiting = false; liveDraw(); });
}

function liveDraw() {
  const { source } = view, now = performance.now();
  if (!source.count) return;
  view.first = source.t[0]; view.last = Math.max(source.t[source.count - 1], view.first + 1e6);
  view.head.span = [view.first, view.last];
  if (live.following) { view.to = view.last; view.from = Math.max(view.first, view.last - live.span); }
  journey?.grow();
  if (now - live.slow > SLOW_MS) { live.slow = now; slowDraw(); }
  if (live.following) { drawAll(); showValues(); }
  document.documentElement.dataset.drawn = String(source.count);
}

// What costs more, or changes less.
async function slowDraw() {
  overview.key = null;
  if (!live.following) overview.refresh();
  showFacts();
  const selection = table_.selection;
  if (!$("filter").value.trim()) { table_.selection = { rows: null, filter: "", count: view.source.count }; $("frames-count").textContent = grouped(view.source.count); }
  else if (selection.rows) await table_.filter($("filter").value);
  if (live.following) { table_.first = table_.most; table_.draw(); }
  eventList();
  if (live.following && !$("tab-events").hidden) $("tab-events").scrollTop = 1e9;
  view.head.stats.messages = liveStats();
  statsList();
}

function liveStats() {
  const { source, head } = view;
  return head.messages.filter(message => source.groups[message.number]?.count).map(message => {
    const { rows, count } = source.groups[message.number], first = source.t[rows[0]], last = source.t[rows[count - 1]];
    return { id: message.idText, message: message.name, frames: count, rate_hz: count > 1 ? (count - 1) / ((last - first) / NS) : null, period_ms: message.period };
  });
}

function pause() { if (live.on && live.following) { live.following = false; showLive(); } }
function toggleFollow() {
  if (live.ended) { report(); return; }
  live.following = !live.following;
  if (live.following) { live.span = Math.min(Math.max(view.to - view.from, 2e9), 300e9); unpin(); setCursor(null); arrived(); }
  showLive();
}
function showLive() {
  const button = $("follow");
  button.textContent = live.ended ? "Show the report" : live.following ? "❚❚ Pause" : "▶ Resume";
  $("state").textContent = live.ended ? "ended" : live.following ? "live" : "paused";
  $("state").className = live.following && !live.ended ? "on" : "";
}
function say(text) { live.remark = text; $("warnings").hidden = !text; $("warnings").textContent = text; }

// Desk and faults of the train: one viewer at a time has them, others look on. The lever goes to 0 when the page closes.
const DESK_KEYS = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right", " ": "space" };
const DESK_SIGNS = { up: "↑", down: "↓", left: "←", right: "→", space: "Space" };
function startDesk() {
  $("desk").hidden = false;
  live.controls = [["desk", "the desk"], ["faults", "the faults"]].filter(([name]) => view.head[name]).map(([, text]) => text).join(" and ");
  $("take").onclick = () => tellDesk({ kind: live.holder === "you" ? "leave" : "take" });
  $("keys-of-desk").replaceChildren(...(view.head.desk ?? []).map(([key, text]) => {
    const button = document.createElement("button"), sign = document.createElement("kbd");
    sign.textContent = DESK_SIGNS[key] ?? key;
    button.append(sign, ` ${text}`); button.dataset.key = key;
    button.onclick = () => tellDesk({ kind: "key", key });
    return button;
  }));
  showDesk();
}
function tellDesk(told) { if (live.socket?.readyState === 1) live.socket.send(JSON.stringify(told)); }
function showDesk() {
  if (!live.controls) return;
  const { controls } = live, mine = live.holder === "you", other = live.holder === "another", Controls = controls[0].toUpperCase() + controls.slice(1);
  $("take").disabled = other || live.ended;
  $("take").textContent = `${mine ? "Leave" : "Take"} ${controls}`;
  const keys = view.head.desk ? "; the keys of the desk go to the train" : "";
  $("holder").textContent = live.ended ? "" : mine ? `You have ${controls}${keys}.` : other ? `Another viewer has ${controls}; this page looks on.` : `${Controls} ${controls.endsWith("desk") ? "is" : "are"} free.`;
  for (const button of $("keys-of-desk").children) button.disabled = !mine;
  allowFaults(mine);
}
// Whether the desk takes a key of the keyboard.
function deskKey(event) {
  if (!view.head.desk || live.holder !== "you" || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, summary, dialog, button")) return false;
  const key = DESK_KEYS[event.key] ?? event.key;
  if (!view.head.desk.some(([name]) => name === key)) return false;
  tellDesk({ kind: "key", key });
  event.preventDefault();
  return true;
}
