// State of the page: span, cursor, panels, and the listeners for changes.

const view = {
  head: null, source: null, signals: [], byFull: null,
  from: 0, to: 1, first: 0, last: 1, // ns since the zero of the log
  cursor: null, pinned: false, hover: null,
  panels: [], // arrays of full names
  spans: [], // earlier spans, for Back
  listeners: { span: [], cursor: [], panels: [], theme: [] },
};
const SPAN_MIN = 20e3; // 20 µs: less than the shortest frame

function tell(what) {
  for (const each of view.listeners[what]) each();
  if (what === "span" || what === "panels") remember();
}
const pending = new Set();
function soon(what) {
  if (!pending.size) requestAnimationFrame(() => { const all = [...pending]; pending.clear(); all.forEach(tell); });
  pending.add(what);
}

function setSpan(from, to, keep = true) {
  pause();
  const whole = view.last - view.first, length = Math.min(Math.max(to - from, SPAN_MIN), whole * 1.04);
  if (to - from !== length) { const middle = (from + to) / 2; from = middle - length / 2; to = middle + length / 2; }
  const low = view.first - 0.02 * whole, high = view.last + 0.02 * whole;
  if (from < low) { to += low - from; from = low; }
  if (to > high) { from -= to - high; to = high; }
  if (keep) { view.spans.push([view.from, view.to]); if (view.spans.length > 100) view.spans.shift(); }
  view.from = from; view.to = to;
  soon("span");
}
function wholeSpan() { setSpan(view.first, view.last); }
function backSpan() { const span = view.spans.pop(); if (span) setSpan(span[0], span[1], false); }
function zoom(factor, about) { setSpan(about - (about - view.from) * factor, about + (view.to - about) * factor, false); }
function pan(ratio) { const by = (view.to - view.from) * ratio; setSpan(view.from + by, view.to + by, false); }

// Moves the cursor; a pinned one stays until it is pinned elsewhere or released.
function setCursor(t, pin = false) {
  if (t !== null) t = Math.min(Math.max(t, view.first), view.last);
  if (pin) pause();
  if (pin) { view.pinned = true; view.cursor = t; view.hover = null; }
  else if (view.pinned) view.hover = t;
  else view.cursor = t;
  soon("cursor");
}
function unpin() { view.pinned = false; view.hover = null; soon("cursor"); }

// Shows an instant: puts the cursor there, and moves the span if the instant is outside.
function goTo(t) {
  if (t < view.from || t > view.to) { const half = (view.to - view.from) / 2; setSpan(t - half, t + half); }
  setCursor(t, true);
}

function timeText(t, digits = 6) { return (t / NS).toFixed(digits); }
function spanText(ns) {
  const s = Math.abs(ns) / NS, sign = ns < 0 ? "−" : "";
  if (s >= 120) return `${sign}${Math.floor(s / 60)} min ${(s % 60).toFixed(1)} s`;
  if (s >= 1) return `${sign}${s.toFixed(3)} s`;
  return s >= 1e-3 ? `${sign}${(s * 1e3).toFixed(3)} ms` : `${sign}${(s * 1e6).toFixed(1)} µs`;
}
// Date of an instant in a log with dates, to the nanosecond.
function dateText(t) {
  if (!view.head.date) return "";
  const at = BigInt(view.head.zero) + BigInt(Math.round(t));
  const date = new Date(Number(at / 1000000n)).toISOString().replace("T", " ").slice(0, 19);
  return `${date}.${String(at % 1000000000n).padStart(9, "0")} UTC`;
}

// Keeps what is shown in the address, so that the user can share it.
let remembering = 0;
function remember() {
  if (live.following && live.on) return;
  clearTimeout(remembering);
  remembering = setTimeout(() => {
    const words = new URLSearchParams({ from: (view.from / NS).toFixed(9), to: (view.to / NS).toFixed(9) });
    words.set("panels", view.panels.map(panel => panel.join(",")).join(";"));
    history.replaceState(null, "", `#${words}`);
  }, 250);
}
function recall() {
  const words = new URLSearchParams(location.hash.slice(1));
  const from = Number(words.get("from") ?? NaN) * NS, to = Number(words.get("to") ?? NaN) * NS;
  if (to > from) setSpan(from, to, false);
  if (words.has("at")) setCursor(Number(words.get("at")) * NS, true);
  if (words.has("panels"))
    view.panels = words.get("panels").split(";").map(panel => panel.split(",").filter(name => view.byFull.has(name))).filter(panel => panel.length);
}

const colors = {};
function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["paper", "card", "ink", "quiet", "rule", "grid", "soft", "bad", "warn", "accent", "cursor"])
    colors[name] = style.getPropertyValue(`--${name}`).trim();
  const dark = document.documentElement.dataset.theme === "dark";
  colors.lines = dark
    ? ["#7fb0f5", "#f0a646", "#ff7d66", "#4ccb9f", "#b7a2f3", "#4cc7dc", "#f08cc4", "#cfc06a"]
    : ["#1f5fbf", "#d97a00", "#c2331f", "#0b7a5b", "#6a4fb3", "#0093a8", "#b0357e", "#7a6a12"];
  colors.states = dark
    ? ["#1d3556", "#123c30", "#44330f", "#322852", "#4a1f18", "#123b44", "#45203a", "#3a3413"]
    : ["#dbe7f8", "#d8efe6", "#fbecc8", "#e8e1f8", "#fbe0da", "#d5eef2", "#f7dcec", "#ece7c6"];
  colors.weights = [colors.quiet, colors.warn, colors.bad];
}

// Returns the drawing context of a canvas as sharp as the screen, with page pixels as units.
const FONT = "11.5px system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";
function sharp(canvas) {
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, box.width, box.height);
  context.font = FONT;
  return { context, width: box.width, height: box.height };
}

// Round steps for an axis: 1, 2 or 5 times a power of ten.
function ticks(low, high, count) {
  const rough = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(each => each * power).find(each => each >= rough) || rough;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return { step, at: found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}
