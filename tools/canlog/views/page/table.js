// The frame table: only visible rows exist; it follows the cursor, and moves it.

const ROW = 22, LATE = 1.5;

class FrameTable {
  constructor() {
    this.box = document.getElementById("rows");
    this.inner = document.getElementById("rows-inner");
    this.thumb = document.querySelector("#rows-bar i");
    this.first = 0; // number of the first row shown, with a fraction
    this.at = -1; this.selection = { rows: null, filter: "", count: 0 };
    this.drawn = 0;
    document.getElementById("frames-head").innerHTML =
      ["time, s|n", "since last|n d", "cycle|n d cycle", "bus", "id", "message", "len", "data", "signals"]
        .map(each => each.split("|")).map(([text, kind = ""]) => `<span class="${kind}">${text}</span>`).join("");
    this.steer();
  }

  get room() { return this.box.clientHeight / ROW; }
  get most() { return Math.max(0, this.selection.count - Math.floor(this.room)); }

  async filter(text) {
    const field = document.getElementById("filter"), note = document.getElementById("filter-note");
    try {
      this.selection = await view.source.select(text);
    } catch (error) {
      field.classList.add("bad"); note.classList.add("bad"); note.textContent = error.message;
      return;
    }
    field.classList.remove("bad"); note.classList.remove("bad");
    const part = this.selection.count / view.source.count;
    note.textContent = text.trim() ? `${grouped(this.selection.count)} (${(100 * part).toPrecision(3)} %)` : "";
    document.getElementById("frames-count").textContent = grouped(this.selection.count);
    this.at = -1; this.drawn = NaN;
    await this.follow();
    this.draw();
  }

  // Shows the row under the cursor.
  async follow() {
    const t = view.cursor;
    if (t === null || !this.selection.count) { if (this.at >= 0) { this.at = -1; this.draw(); } return; }
    const row = await view.source.rowAt(this.selection, t);
    if (row === this.at) return;
    this.at = row;
    if (row < this.first + 1 || row > this.first + this.room - 2) this.first = Math.min(Math.max(0, row - Math.floor(this.room / 2)), this.most);
    this.draw();
  }

  scroll(first) { this.first = Math.min(Math.max(0, first), this.most); this.draw(); }

  async draw() {
    if (document.getElementById("tab-frames").hidden) return;
    const stamp = this.stamp = {};
    const from = Math.floor(this.first), count = Math.ceil(this.room) + 1;
    const size = Math.max(24, this.box.clientHeight * Math.min(1, this.room / Math.max(1, this.selection.count)));
    this.thumb.style.height = `${size}px`;
    this.thumb.style.top = `${(this.box.clientHeight - size) * (this.most ? this.first / this.most : 0)}px`;
    const got = view.source.rows(this.selection, from, count);
    if (got instanceof Promise) this.inner.classList.add("waiting");
    const rows = await got;
    if (stamp !== this.stamp) return;
    this.inner.classList.remove("waiting");
    this.inner.replaceChildren(...rows.map((row, k) => this.row(row, from + k)));
    this.inner.style.transform = `translateY(${-(this.first - from) * ROW}px)`;
    if (!rows.length) this.inner.innerHTML = '<p class="nothing">No frame passes the filter.</p>';
  }

  row(row, number) {
    const element = document.createElement("div"), { message } = row;
    element.className = "row" + (number === this.at ? " at" : "") + (row.flags & ERROR_FLAG ? " error" : "");
    const period = message.period;
    if (period && row.gap > LATE * period * 1e6) element.classList.add("late");
    const cell = (kind, text) => { const span = document.createElement("span"); span.className = kind; span.textContent = text; element.append(span); return span; };
    cell("n mono", timeText(row.t, 6)).title = dateText(row.t) || timeText(row.t, 9);
    cell("n d", Number.isNaN(row.gap) ? "" : gapText(row.gap)).title = period ? `every ${period} ms` : "";
    cell("n d cycle", row.cycle ? row.cycle - 1 : "").title = row.cycle ? `control cycle ${row.cycle - 1}` : "";
    cell("bus", row.channel + (row.flags & TX_FLAG ? " tx" : ""));
    cell("id mono", message.idText);
    cell("name", message.name).title = message.comment || "";
    cell("n mono", row.length);
    const hex = cell("hex mono", "");
    row.data.forEach((byte, k) => {
      const changed = row.before && row.before[k] !== byte, text = byte.toString(16).toUpperCase().padStart(2, "0");
      if (k) hex.append(" ");
      if (changed) { const mark = document.createElement("b"); mark.textContent = text; hex.append(mark); } else hex.append(text);
    });
    const signals = cell("sig", "");
    const refused = view.head.verdicts[row.verdict];
    if (refused) { element.classList.add("refused"); const mark = document.createElement("em"); mark.textContent = refused; signals.append(mark, " "); }
    const told = decodedTexts(message, row.data);
    told.forEach(([name, text], k) => { if (k) signals.append("  "); signals.append(`${name} `); const value = document.createElement("b"); value.textContent = text; signals.append(value); });
    signals.title = told.map(([name, text]) => `${name}: ${text}`).join("\n");
    element.onclick = () => { this.at = number; goTo(row.t); this.draw(); };
    return element;
  }

  steer() {
    this.box.addEventListener("wheel", event => {
      event.preventDefault();
      this.scroll(this.first + event.deltaY * (event.deltaMode === 1 ? 1 : 1 / ROW));
    }, { passive: false });
    const bar = document.getElementById("rows-bar");
    let held = null;
    bar.addEventListener("pointerdown", event => {
      bar.setPointerCapture(event.pointerId);
      const box = this.thumb.getBoundingClientRect();
      held = event.clientY >= box.top && event.clientY <= box.bottom ? event.clientY - box.top : box.height / 2;
      move(event);
    });
    const move = event => {
      if (held === null) return;
      const box = bar.getBoundingClientRect(), size = this.thumb.getBoundingClientRect().height;
      this.scroll((event.clientY - held - box.top) / Math.max(1, box.height - size) * this.most);
    };
    bar.addEventListener("pointermove", move);
    bar.addEventListener("pointerup", () => { held = null; });
    new ResizeObserver(() => this.scroll(this.first)).observe(this.box);
  }

  // Moves the cursor by frames that pass the filter.
  async step(by) {
    if (!this.selection.count) return;
    const now = this.at < 0 && view.cursor !== null ? await view.source.rowAt(this.selection, view.cursor) : this.at;
    const next = Math.min(Math.max(now + by, 0), this.selection.count - 1);
    const [row] = await view.source.rows(this.selection, next, 1);
    this.at = next;
    if (next < this.first + 1 || next > this.first + this.room - 2) this.first = Math.min(Math.max(0, next - Math.floor(this.room / 2)), this.most);
    goTo(row.t);
    this.draw();
  }
}

function decodedTexts(message, data) {
  const found = [];
  for (const first of message.signals) {
    const signal = [first, ...first.others].find(page => carriedByFrame(message, page, data));
    if (!signal) continue;
    const raw = rawExact(signal, at => data[at]), value = physicalExact(signal, raw);
    const exact = Number.isInteger(signal.scale) && Number.isInteger(signal.offset) && !signal.float
      ? String(raw * BigInt(signal.scale) + BigInt(signal.offset)) : null;
    const named = signal.choices[raw] ?? flagsText(signal, Number(raw));
    const text = named || exact || numberText(value, signal);
    found.push([signal.name, named || !signal.unit || signal.unit === "1" ? text : `${text} ${signal.unit}`]);
  }
  return found;
}

function gapText(ns) {
  const ms = ns / 1e6;
  return ms >= 1e5 ? `${(ms / 1e3).toFixed(1)} s` : `${ms.toFixed(ms < 100 ? 3 : 1)} ms`;
}
function grouped(count) { return String(count).replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f"); }
