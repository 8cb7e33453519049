// Speed over distance: line limits, ceiling, emergency limit, speed and truth, and the authority at
// the cursor.

const ROLES = {
  truth: { color: 3, width: 2.2, label: "true speed" },
  estimate: { color: 0, width: 1.4, label: "estimate" },
  target: { color: 5, width: 1, label: "target" },
  ceiling: { color: 1, width: 1.3, label: "ceiling" },
  emergency: { color: 2, width: 1.3, label: "emergency brake" },
};
const KMH = 3.6, JUMP = 2e9;
const BASE = 22, STRIP = 24; // height below the floor: the axis, and the strip with the train
const FAR_AUTHORITY_M = 5000;

// Place at an instant, between the samples on both sides; the last one is extended a little.
function placeAt(trace, t) {
  const at = trace.indexAt(t);
  if (at < 0) return NaN;
  const next = Math.min(at + 1, trace.t.length - 1), back = next === at ? Math.max(0, at - 1) : at, step = trace.t[next] - trace.t[back];
  if (!step) return trace.v[at];
  return trace.v[back] + (trace.v[next] - trace.v[back]) * Math.min(2, (t - trace.t[back]) / step);
}

class Journey {
  constructor(section, told, block) {
    this.section = section; this.told = told; this.canvas = section.querySelector("canvas");
    this.curves = told.curves.map((curve, number) => {
      const column = axis => told.place ? EMPTY : block.column(`curve ${number} ${axis}`);
      return { ...curve, ...ROLES[curve.role], t: column("t"), x: column("x"), y: column("y") };
    });
    this.authority = told.authority ? new Trace(block.column("authority t"), Float64Array.from(block.column("authority x"))) : null;
    this.own = ["truth", "estimate"].map(role => this.curves.find(curve => curve.role === role)).find(Boolean) || this.curves[0];
    this.base = told.train ? BASE + STRIP : BASE;
    this.moved = false; // whether the user chose what is shown
    if (told.place) this.empty(); else { this.extent(); this.low = this.first; this.high = this.last; }
    section.hidden = Boolean(told.place);
    this.steer();
  }

  extent() {
    let low = Infinity, high = -Infinity, top = 0;
    for (const curve of this.curves) for (let i = 0; i < curve.x.length; i++) {
      low = Math.min(low, curve.x[i]); high = Math.max(high, curve.x[i]); top = Math.max(top, curve.y[i]);
    }
    const pad = Math.max(5, 0.01 * (high - low));
    this.first = low - pad; this.last = high + pad; this.top = top * KMH * 1.08 || 1;
  }

  // On the live page the curves grow: speed over the last known place, and the end of authority.
  empty() {
    this.grown = this.curves.map(() => ({ done: 0, t: new Grow(Float64Array), x: new Grow(Float64Array), y: new Grow(Float64Array) }));
    this.ends = { done: 0, t: new Grow(Float64Array), x: new Grow(Float64Array) };
    this.low = this.first = Infinity; this.high = this.last = -Infinity; this.top = 1;
    for (const [, , limit] of this.told.limits) this.top = Math.max(this.top, limit * KMH * 1.08);
  }

  grow() {
    const place = view.byFull.get(this.told.place), where = place && view.source.trace(place), start = view.source.t[0];
    if (!where?.t.length) return;
    this.curves.forEach((curve, number) => {
      const grown = this.grown[number];
      this.append(grown, view.byFull.get(curve.name), where, start, value => value);
      curve.t = grown.t.view; curve.x = grown.x.view; curve.y = grown.y.view;
    });
    const ahead = view.byFull.get("VOBC_TARGET.distance_to_authority_m");
    if (ahead) {
      this.append(this.ends, ahead, where, start, null);
      this.authority = new Trace(this.ends.t.view, this.ends.x.view);
    }
    const wide = this.high - this.low, end = this.authority?.valueAt(view.last), first = this.moved;
    this.last = Math.max(this.last, Number.isFinite(end) ? end + 30 : 0);
    if (!first) { this.low = this.first; this.high = this.last; }
    if (this.section.hidden) { this.section.hidden = false; this.key(); } else if (!wide) this.key();
  }

  append(grown, signal, where, start, value) {
    if (!signal) return;
    const trace = view.source.trace(signal);
    // The source drops its oldest frames now and then; what remains is found by its instant.
    while (grown.t.length && grown.t.room[0] < start) for (const name of ["t", "x", "y"]) grown[name]?.drop(lowerBound(grown.t.view, start));
    const last = grown.t.length ? grown.t.room[grown.t.length - 1] : -Infinity;
    for (let i = upperBound(trace.t, last); i < trace.t.length; i++) {
      const x = placeAt(where, trace.t[i]);
      if (Number.isNaN(x)) continue;
      if (value === null && trace.v[i] > FAR_AUTHORITY_M) continue;
      grown.t.push(trace.t[i]);
      grown.x.push(value === null ? x + trace.v[i] : x);
      if (value === null) continue;
      grown.y.push(trace.v[i]);
      this.first = Math.min(this.first, x - 30); this.last = Math.max(this.last, x + 30); this.top = Math.max(this.top, trace.v[i] * KMH * 1.08);
    }
  }

  x(place, width) { return LEFT + (place - this.low) / (this.high - this.low) * (width - LEFT - RIGHT); }
  place(x, width) { return this.low + (x - LEFT) / (width - LEFT - RIGHT) * (this.high - this.low); }
  y(kmh, height) { return height - this.base - kmh / this.top * (height - this.base - 8); }

  key() {
    const box = document.getElementById("journey-key");
    const entries = this.curves.map(curve => [curve.label, colors.lines[curve.color]]);
    if (this.told.limits.length) entries.unshift(["line limit", colors.quiet]);
    if (this.authority) entries.push(["end of authority at the cursor", colors.accent]);
    box.replaceChildren(...entries.map(([label, color]) => {
      const chip = document.createElement("span");
      chip.className = "chip";
      chip.innerHTML = "<i></i><span></span>";
      chip.firstChild.style.background = color; chip.lastChild.textContent = label;
      return chip;
    }));
  }

  draw() {
    const { context, width, height } = sharp(this.canvas), floor = this.y(0, height);
    this.grid(context, width, height, floor);
    context.save();
    context.beginPath(); context.rect(LEFT, 0, width - LEFT - RIGHT, floor + 4); context.clip();
    this.line(context, width, height);
    for (const curve of [...this.curves].sort((a, b) => (a.role === "estimate") - (b.role === "estimate"))) this.curve(context, curve, width, height);
    this.now(context, width, height, floor);
    context.restore();
    if (this.told.train) this.strip(context, width, floor);
  }

  // The train on the line: its length, the interval of its front, tags, stations and authority.
  strip(context, width, floor) {
    const y = floor + 13, at = place => Math.min(width - RIGHT, Math.max(LEFT, this.x(place, width)));
    context.strokeStyle = colors.quiet; context.lineWidth = 2; context.beginPath(); context.moveTo(LEFT, y); context.lineTo(width - RIGHT, y); context.stroke();
    const t = drive.t, front = this.own.t.length ? this.own.x[Math.max(0, upperBound(this.own.t, t) - 1)] : NaN, start = this.own.x[0];
    const end = this.authority?.valueAt(t);
    for (const [, place] of this.told.stations) { const x = this.x(place, width); if (x >= LEFT && x <= width - RIGHT) { context.fillStyle = colors.rule; context.fillRect(at(place - this.told.train), y + 4, Math.max(3, at(place) - at(place - this.told.train)), 5); } }
    if (!Number.isFinite(front)) return;
    if (Number.isFinite(end) && end > front) { context.strokeStyle = colors.accent; context.lineWidth = 4; context.beginPath(); context.moveTo(at(front), y); context.lineTo(at(end), y); context.stroke(); context.fillStyle = colors.accent; context.fillRect(at(end) - 1, y - 7, 3, 14); }
    for (const [, place] of this.told.tags) {
      const x = this.x(place, width), passed = place >= start && place <= front;
      if (x < LEFT || x > width - RIGHT) continue;
      context.beginPath(); context.moveTo(x, y - 3); context.lineTo(x - 3.5, y - 9); context.lineTo(x + 3.5, y - 9); context.closePath();
      context.strokeStyle = context.fillStyle = passed ? colors.ink : colors.quiet; context.lineWidth = 1;
      if (passed) context.fill(); else context.stroke();
    }
    context.fillStyle = colors.ink; context.fillRect(at(front - this.told.train), y - 5, Math.max(4, at(front) - at(front - this.told.train)), 10);
    const half = view.drive?.uncertainty;
    if (Number.isFinite(half)) {
      context.strokeStyle = colors.bad; context.lineWidth = 1.5; context.beginPath();
      const from = at(front - half), to = Math.max(at(front + half), at(front - half) + 2);
      context.moveTo(from, y - 8); context.lineTo(from, y + 8); context.moveTo(to, y - 8); context.lineTo(to, y + 8); context.moveTo(from, y); context.lineTo(to, y); context.stroke();
    }
  }

  grid(context, width, height, floor) {
    const across = ticks(this.low, this.high, width / 110), up = ticks(0, this.top, 4);
    context.strokeStyle = colors.grid; context.lineWidth = 1; context.beginPath();
    for (const place of across.at) { const x = Math.round(this.x(place, width)) + 0.5; context.moveTo(x, 0); context.lineTo(x, floor); }
    for (const kmh of up.at) { const y = Math.round(this.y(kmh, height)) + 0.5; context.moveTo(LEFT, y); context.lineTo(width - RIGHT, y); }
    context.stroke();
    context.fillStyle = colors.quiet; context.textBaseline = "middle"; context.textAlign = "right";
    for (const kmh of up.at) context.fillText(String(Math.round(kmh)), LEFT - 7, this.y(kmh, height));
    context.textBaseline = "top"; context.textAlign = "center";
    for (const place of across.at) { const x = this.x(place, width); if (x > LEFT + 8 && x < width - 40) context.fillText(axisText(place, across), x, height - 15); }
    context.textAlign = "right"; context.fillText("m", width - 2, height - 15);
    for (const [name, place] of this.told.stations) {
      const x = this.x(place, width);
      if (x < LEFT || x > width - RIGHT) continue;
      context.strokeStyle = colors.rule; context.lineWidth = 2; context.beginPath(); context.moveTo(x, 0); context.lineTo(x, floor); context.stroke();
      context.fillStyle = colors.ink; context.textAlign = x > width - 80 ? "right" : "left"; context.textBaseline = "top";
      context.fillText(name, x + (x > width - 80 ? -4 : 4), 0);
    }
  }

  line(context, width, height) {
    context.strokeStyle = colors.quiet; context.lineWidth = 1; context.setLineDash([5, 3]); context.beginPath();
    for (const [from, to, limit] of this.told.limits) {
      const y = this.y(limit * KMH, height);
      context.lineTo(this.x(from, width), y); context.lineTo(this.x(to, width), y);
    }
    context.stroke(); context.setLineDash([]);
  }

  // Samples within one pixel are left out.
  curve(context, curve, width, height) {
    context.strokeStyle = colors.lines[curve.color]; context.lineJoin = "round";
    for (const inside of [false, true]) {
      context.globalAlpha = inside ? 1 : 0.28; context.lineWidth = inside ? curve.width : 1; context.beginPath();
      let pen = false, lastX = NaN, lastY = NaN;
      for (let i = 0; i < curve.t.length; i++) {
        const here = curve.t[i] >= view.from && curve.t[i] <= view.to;
        if (here !== inside || curve.x[i] < this.low - 50 || curve.x[i] > this.high + 50) { pen = false; continue; }
        const x = this.x(curve.x[i], width), y = this.y(curve.y[i] * KMH, height);
        if (pen && Math.abs(x - lastX) < 0.3 && Math.abs(y - lastY) < 0.3) continue;
        if (pen && curve.t[i] - curve.t[i - 1] < JUMP) context.lineTo(x, y); else context.moveTo(x, y);
        pen = true; lastX = x; lastY = y;
      }
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  now(context, width, height, floor) {
    const t = view.cursor ?? (live.on ? view.last : null);
    if (t === null) return;
    const at = upperBound(this.own.t, t) - 1;
    if (at < 0) return;
    const x = this.x(this.own.x[at], width), y = this.y(this.own.y[at] * KMH, height);
    if (this.authority) {
      const end = this.authority.valueAt(t), authorityX = this.x(end, width);
      if (Number.isFinite(end)) {
        const label = `authority ends at ${end.toFixed(1)} m`, shown = Math.min(authorityX, width - RIGHT - 1);
        context.strokeStyle = colors.accent; context.lineWidth = 2; context.beginPath(); context.moveTo(shown, 14); context.lineTo(shown, floor); context.stroke();
        context.fillStyle = colors.accent; context.globalAlpha = 0.07; context.fillRect(x, 0, shown - x, floor); context.globalAlpha = 1;
        context.textBaseline = "bottom"; context.textAlign = shown > width - 190 ? "right" : "left";
        context.fillText(authorityX > width ? `${label} →` : label, shown + (shown > width - 190 ? -5 : 5), floor - 3);
      }
    }
    context.strokeStyle = colors.cursor; context.lineWidth = 1; context.beginPath(); context.moveTo(x, 0); context.lineTo(x, floor); context.stroke();
    for (const curve of this.curves) {
      const near = upperBound(curve.t, t) - 1;
      if (near < 0) continue;
      context.fillStyle = colors.lines[curve.color]; context.beginPath(); context.arc(this.x(curve.x[near], width), this.y(curve.y[near] * KMH, height), 3, 0, 7); context.fill();
    }
    context.fillStyle = colors.ink; context.textBaseline = "middle"; context.textAlign = x > width - 170 ? "right" : "left";
    context.fillText(`${this.own.x[at].toFixed(1)} m, ${(this.own.y[at] * KMH).toFixed(1)} km/h`, x + (x > width - 170 ? -9 : 9), Math.max(22, y - 10));
  }

  steer() {
    const canvas = this.canvas;
    let drag = null;
    const at = event => { const box = canvas.getBoundingClientRect(); return { x: event.clientX - box.left, y: event.clientY - box.top, width: box.width, height: box.height }; };
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      const { x, width } = at(event), about = this.place(x, width), factor = 1.0018 ** event.deltaY;
      this.show(about - (about - this.low) * factor, about + (this.high - about) * factor);
    }, { passive: false });
    canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); drag = { ...at(event), low: this.low, high: this.high, moved: false }; });
    canvas.addEventListener("pointermove", event => {
      const here = at(event);
      if (!drag) { setCursor(this.nearest(here)); return; }
      drag.moved ||= Math.abs(here.x - drag.x) > CLICK_PX;
      const by = (drag.x - here.x) / (here.width - LEFT - RIGHT) * (drag.high - drag.low);
      if (drag.moved) this.show(drag.low + by, drag.high + by);
    });
    canvas.addEventListener("pointerup", event => { if (drag && !drag.moved) setCursor(this.nearest(at(event)), true); drag = null; });
    canvas.addEventListener("pointerleave", () => { if (!drag) setCursor(null); });
    canvas.addEventListener("dblclick", () => { this.show(this.first, this.last); this.moved = false; });
  }

  show(low, high) {
    this.moved = true;
    const length = Math.min(Math.max(high - low, 1), this.last - this.first);
    low = Math.min(Math.max(low, this.first), this.last - length);
    this.low = low; this.high = low + length;
    requestAnimationFrame(() => this.draw());
  }

  // The instant at which the train was nearest to a point of the picture.
  nearest({ x, y, width, height }) {
    const curve = this.own;
    let best = Infinity, found = null;
    for (let i = 0; i < curve.t.length; i++) {
      const dx = this.x(curve.x[i], width) - x;
      if (dx > 60 || dx < -60) continue;
      const dy = (this.y(curve.y[i] * KMH, height) - y) * 0.35, away = dx * dx + dy * dy;
      if (away < best) { best = away; found = curve.t[i]; }
    }
    return found ?? view.cursor;
  }
}
