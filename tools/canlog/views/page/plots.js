// Panels of signals over time: lines with axes above, bands of states below, one cursor for all.

const RIGHT = 10, BAND = 20, TOP = 6, HEAD = 26;
const LEFT_LEAST = 64, LEFT_MOST = 168;
const LINE_LEAST = 72, LINE_MOST = 240;
let LEFT = LEFT_LEAST;

// Sets the left margin of all plots, wide enough for the names of bands.
function fitMargin(panels) {
  const context = document.createElement("canvas").getContext("2d");
  context.font = FONT;
  const widths = panels.flatMap(panel => panel.states.map(signal => context.measureText(signal.full.split(".")[1]).width + 12));
  LEFT = Math.ceil(Math.min(LEFT_MOST, Math.max(LEFT_LEAST, ...widths)));
  document.documentElement.style.setProperty("--left", `${LEFT}px`);
}

function xOf(t, width) { return LEFT + (t - view.from) / (view.to - view.from) * (width - LEFT - RIGHT); }
function tOf(x, width) { return view.from + (x - LEFT) / (width - LEFT - RIGHT) * (view.to - view.from); }

class Panel {
  constructor(names, number) {
    this.number = number;
    this.signals = names.map(name => view.byFull.get(name));
    this.lines = this.signals.filter(signal => !signal.state);
    this.states = this.signals.filter(signal => signal.state);
    this.windows = new Map();
    this.asked = 0;
    this.element = document.createElement("div");
    this.element.className = "panel";
    this.element.innerHTML = `<div class="head"><span class="axis"></span><span class="chips"></span>
      <span class="panel-tools"><button data-do="up" title="Up" aria-label="Panel up">↑</button><button data-do="gone" title="Remove panel" aria-label="Remove panel">×</button></span></div>
      <canvas tabindex="0"></canvas>`;
    this.canvas = this.element.querySelector("canvas");
    this.fit(LINE_LEAST);
    const units = [...new Set(this.lines.map(signal => signal.unit).filter(unit => unit && unit !== "1"))];
    this.element.querySelector(".axis").textContent = units.join(", ");
    this.chips();
    steer(this.canvas);
  }

  fit(line) { this.canvas.style.height = `${(this.lines.length ? line : TOP) + BAND * this.states.length}px`; }

  color(signal) { return colors.lines[this.lines.indexOf(signal) % colors.lines.length]; }

  chips() {
    const box = this.element.querySelector(".chips");
    box.replaceChildren(...this.signals.map(signal => {
      const [message, name] = signal.full.split(/\.(.*)/);
      const chip = document.createElement("span");
      chip.className = "chip";
      chip.title = signal.comment || signal.full;
      chip.innerHTML = `<i></i><span><span class="msg"></span><span class="sig"></span></span><b></b><button title="Remove" aria-label="Remove ${signal.full}">×</button>`;
      chip.querySelector("i").style.background = signal.state ? "transparent" : this.color(signal);
      chip.querySelector(".msg").textContent = `${message}.`;
      chip.querySelector(".sig").textContent = name;
      chip.querySelector("button").onclick = () => removeSignal(this.number, signal.full);
      return chip;
    }));
    this.shown = [...box.querySelectorAll("b")];
  }

  visible() {
    const box = this.canvas.getBoundingClientRect(), frame = this.element.parentElement.getBoundingClientRect();
    return box.bottom > frame.top && box.top < frame.bottom;
  }

  // Fetches what the span needs, then draws; late answers are drawn when they arrive.
  refresh() {
    if (!this.visible()) { this.stale = true; return; }
    this.stale = false;
    const columns = Math.max(1, Math.round(this.canvas.getBoundingClientRect().width - LEFT - RIGHT));
    const asked = ++this.asked;
    for (const signal of this.signals) {
      const got = view.source.window(signal, view.from, view.to, columns);
      if (got instanceof Promise) got.then(window => { if (asked >= this.asked) { this.windows.set(signal, window); this.draw(); } }, complain);
      else this.windows.set(signal, got);
    }
    this.draw();
  }

  draw() {
    const { context, width, height } = sharp(this.canvas);
    if (width < LEFT + RIGHT + 20) return;
    const bottom = height - BAND * this.states.length - (this.lines.length ? 4 : 0);
    const limits = this.limits();
    const yOf = value => bottom - 6 - (value - limits[0]) / (limits[1] - limits[0]) * (bottom - TOP - 8);
    this.grid(context, width, height, bottom, limits, yOf);
    marks(context, width, height);
    context.save();
    context.beginPath(); context.rect(LEFT, 0, width - LEFT - RIGHT, height); context.clip();
    for (const signal of this.lines) this.line(context, signal, width, yOf);
    this.states.forEach((signal, row) => this.band(context, signal, width, height - BAND * (this.states.length - row)));
    context.restore();
    context.fillStyle = colors.quiet; context.textAlign = "right"; context.textBaseline = "middle";
    this.states.forEach((signal, row) => context.fillText(
      fitted(context, signal.full.split(".")[1], LEFT - 10), LEFT - 7, height - BAND * (this.states.length - row - 0.5)));
    cursors(context, width, height);
  }

  limits() {
    let low = Infinity, high = -Infinity;
    for (const signal of this.lines) {
      const { t, v } = this.windows.get(signal) ?? { t: [], v: [] };
      // Visible samples, and the neighbours whose lines reach into the picture.
      const stop = Math.min(t.length, upperBound(t, view.to) + 1);
      for (let i = Math.max(0, lowerBound(t, view.from) - 1); i < stop; i++)
        if (Number.isFinite(v[i])) { if (v[i] < low) low = v[i]; if (v[i] > high) high = v[i]; }
    }
    if (low > high) return [0, 1];
    if (low === high) { const half = Math.abs(low) * 0.1 || 1; return [low - half, high + half]; }
    return [low, high];
  }

  grid(context, width, height, bottom, limits, yOf) {
    context.strokeStyle = colors.grid; context.lineWidth = 1; context.beginPath();
    for (const t of ticks(view.from / NS, view.to / NS, width / 110).at) {
      const x = Math.round(xOf(t * NS, width)) + 0.5;
      context.moveTo(x, 0); context.lineTo(x, height);
    }
    if (!this.lines.length) { context.stroke(); return; }
    const marksY = ticks(limits[0], limits[1], 4);
    for (const value of marksY.at) { const y = Math.round(yOf(value)) + 0.5; context.moveTo(LEFT, y); context.lineTo(width - RIGHT, y); }
    context.stroke();
    context.fillStyle = colors.quiet; context.textAlign = "right"; context.textBaseline = "middle";
    for (const value of marksY.at) context.fillText(axisText(value, marksY), LEFT - 7, yOf(value));
  }

  line(context, signal, width, yOf) {
    const got = this.windows.get(signal);
    if (!got || !got.t.length) return;
    context.strokeStyle = context.fillStyle = this.color(signal);
    if (!got.raw) { this.bars(context, got, width, yOf); return; }
    context.lineWidth = 1.4; context.lineJoin = "bevel"; context.beginPath();
    let pen = false;
    for (let i = 0; i < got.t.length; i++) {
      const value = got.v[i];
      if (!Number.isFinite(value)) { pen = false; continue; }
      const x = xOf(got.t[i], width), y = yOf(value);
      if (pen) context.lineTo(x, y); else context.moveTo(x, y);
      pen = true;
    }
    context.stroke();
    if (got.t.length < (width - LEFT) / 7)
      for (let i = 0; i < got.t.length; i++)
        if (Number.isFinite(got.v[i])) { context.beginPath(); context.arc(xOf(got.t[i], width), yOf(got.v[i]), 2.2, 0, 7); context.fill(); }
  }

  // A pixel column with many samples is one bar from minimum to maximum, joined to the bar before.
  // This draws the same picture as a line through all samples, many times faster.
  bars(context, got, width, yOf) {
    let column = null, top = 0, bottom = 0, last = NaN;
    context.lineWidth = 1.2;
    const bar = () => { if (column !== null) context.fillRect(column, top - 0.6, 1.2, bottom - top + 1.2); };
    for (let i = 0; i < got.t.length; i++) {
      if (!Number.isFinite(got.v[i])) { bar(); column = null; continue; }
      const x = Math.floor(xOf(got.t[i], width)), y = yOf(got.v[i]);
      if (x === column) { top = Math.min(top, y); bottom = Math.max(bottom, y); last = y; continue; }
      bar();
      const joined = column !== null && x - column === 1;
      if (column !== null && !joined) { context.beginPath(); context.moveTo(column + 0.5, last); context.lineTo(x + 0.5, y); context.stroke(); }
      top = joined ? Math.min(y, last) : y; bottom = joined ? Math.max(y, last) : y;
      column = x; last = y;
    }
    bar();
  }

  band(context, signal, width, top) {
    context.fillStyle = colors.quiet;
    const got = this.windows.get(signal);
    if (!got) return;
    const values = [...signal.byValue.keys()].sort((a, b) => a - b);
    context.textBaseline = "middle"; context.textAlign = "left";
    for (let i = 0; i < got.t.length;) {
      if (Number.isNaN(got.v[i])) { i++; continue; }
      let next = i + 1;
      while (next < got.t.length && got.v[next] === got.v[i]) next++;
      // A state holds until the next sample, but at most until the message's timeout.
      const hold = signal.gap ? got.t[next - 1] + signal.gap : view.last;
      const end = next < got.t.length ? got.t[next] : Math.min(hold, view.last);
      const left = Math.max(LEFT, xOf(got.t[i], width)), right = Math.min(width - RIGHT, xOf(end, width));
      const known = values.indexOf(got.v[i]);
      context.fillStyle = colors.states[(known < 0 ? values.length : known) % colors.states.length];
      context.fillRect(left, top + 2, Math.max(0.7, right - left), BAND - 4);
      const room = right - left - 8;
      if (room > 14) {
        const text = valueText(signal, got.v[i], Math.round((got.v[i] - signal.offset) / signal.scale));
        context.fillStyle = colors.ink; const cut = fitted(context, text, room);
        if (cut) context.fillText(cut, left + 4, top + BAND / 2 + 0.5);
      }
      i = next;
    }
  }
}

function fitted(context, text, room) {
  if (context.measureText(text).width <= room) return text;
  let kept = text.length;
  while (kept > 2 && context.measureText(`${text.slice(0, kept)}…`).width > room) kept--;
  return kept > 2 ? `${text.slice(0, kept)}…` : "";
}

function axisText(value, { step, digits }) {
  if (Math.abs(value) >= 1e6 || (step < 1e-5 && value)) return value.toExponential(1);
  const text = value.toFixed(Math.min(digits, 9));
  return Math.abs(value) >= 1e4 ? text.replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f") : text.replace("-", "−");
}

// Draws events as thin lines.
function marks(context, width, height) {
  for (const event of view.head.events) {
    if (event.t < view.from || event.t > view.to) continue;
    context.strokeStyle = colors.weights[event.weight];
    context.globalAlpha = 0.22 + 0.3 * event.weight;
    context.lineWidth = 1; context.beginPath();
    const x = Math.round(xOf(event.t, width)) + 0.5;
    context.moveTo(x, 0); context.lineTo(x, height); context.stroke();
  }
  context.globalAlpha = 1;
}

function cursors(context, width, height) {
  for (const [t, dash] of [[view.cursor, view.pinned ? [] : [3, 3]], [view.hover, [2, 4]]]) {
    if (t === null || t < view.from || t > view.to) continue;
    const x = Math.round(xOf(t, width)) + 0.5;
    context.strokeStyle = colors.cursor; context.lineWidth = 1; context.setLineDash(dash);
    context.beginPath(); context.moveTo(x, 0); context.lineTo(x, height); context.stroke();
    context.setLineDash([]);
  }
}

function drawAxis(canvas) {
  const { context, width, height } = sharp(canvas), marksX = ticks(view.from / NS, view.to / NS, width / 110);
  context.fillStyle = colors.quiet; context.textBaseline = "top"; context.textAlign = "center";
  for (const t of marksX.at) {
    const x = xOf(t * NS, width);
    if (x < LEFT - 1 || x > width - 30) continue;
    context.fillRect(Math.round(x), 0, 1, 4);
    context.fillText(t.toFixed(Math.min(9, marksX.digits)).replace("-", "−"), x, 7);
  }
  context.textAlign = "right";
  context.fillText("s", width - 2, 7);
  const t = view.hover ?? view.cursor;
  if (t === null || t < view.from || t > view.to) return;
  const text = timeText(t, Math.min(9, marksX.digits + 3)), half = context.measureText(text).width / 2 + 6;
  const x = Math.min(Math.max(xOf(t, width), half), width - half);
  context.fillStyle = colors.ink; context.fillRect(x - half, 4, 2 * half, height - 6);
  context.fillStyle = colors.paper; context.textAlign = "center"; context.fillText(text, x, 7);
}

// Overview of the whole log: the first line of the first panel, events, and the span as a window.
class Overview {
  constructor(canvas) { this.canvas = canvas; this.window = null; steerOverview(canvas); }
  x(t, width) { return LEFT + (t - view.first) / (view.last - view.first || 1) * (width - LEFT - RIGHT); }
  t(x, width) { return view.first + (x - LEFT) / (width - LEFT - RIGHT) * (view.last - view.first); }

  async refresh() {
    const signal = view.panels.flat().map(name => view.byFull.get(name)).find(each => each && !each.state);
    const width = Math.round(this.canvas.getBoundingClientRect().width - LEFT - RIGHT);
    const key = signal ? `${signal.full} ${width}` : "";
    if (key !== this.key) {
      this.key = key;
      this.window = signal ? await view.source.window(signal, view.first, view.last, width) : null;
    }
    this.draw();
  }

  draw() {
    const { context, width, height } = sharp(this.canvas), left = this.x(view.from, width), right = this.x(view.to, width);
    context.fillStyle = colors.soft; context.fillRect(LEFT, 0, width - LEFT - RIGHT, height);
    context.fillStyle = colors.card; context.fillRect(Math.max(LEFT, left), 0, Math.min(width - RIGHT, right) - Math.max(LEFT, left), height);
    const got = this.window;
    if (got && got.t.length) {
      let low = Infinity, high = -Infinity;
      for (const value of got.v) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
      context.strokeStyle = colors.quiet; context.lineWidth = 1; context.beginPath();
      for (let i = 0; i < got.t.length; i++) context.lineTo(this.x(got.t[i], width), height - 9 - (got.v[i] - low) / (high - low || 1) * (height - 13));
      context.stroke();
    }
    for (const event of view.head.events) {
      context.fillStyle = colors.weights[event.weight];
      context.fillRect(this.x(event.t, width) - 0.5, height - (event.weight ? 7 : 5), event.weight ? 2 : 1, event.weight ? 7 : 5);
    }
    context.strokeStyle = colors.accent; context.lineWidth = 1.5;
    context.strokeRect(Math.max(LEFT, left), 0.75, Math.max(3, Math.min(width - RIGHT, right) - Math.max(LEFT, left)), height - 1.5);
    context.fillStyle = colors.quiet; context.textAlign = "right"; context.textBaseline = "middle";
    context.fillText("overview", LEFT - 7, height / 2);
    if (view.cursor !== null) { context.fillStyle = colors.cursor; context.fillRect(this.x(view.cursor, width), 0, 1, height); }
  }
}
