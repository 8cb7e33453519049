// Same interface as LocalSource, for a log that stays on its server: it fetches only what is shown.

const TILE_ROWS = 200;

class RemoteSource {
  constructor(head) {
    this.head = head; this.count = head.frames.count; this.windows = new Map(); this.tiles = new Map();
  }

  async ask(path, parameters) {
    const answer = await fetch(`${path}?${new URLSearchParams(parameters)}`);
    if (!answer.ok) throw new Error(await answer.text());
    return answer;
  }

  // Requests cover aligned tiles with a margin, so that small pans need no new request.
  async window(signal, from, to, columns) {
    const step = 2 ** Math.ceil(Math.log2((to - from) / 4));
    const first = Math.floor(from / step - 1) * step, last = Math.ceil(to / step + 1) * step;
    const key = `${signal.full} ${first} ${last} ${columns}`;
    if (!this.windows.has(key)) {
      if (this.windows.size > 400) this.windows.clear();
      const count = Math.ceil(columns * (last - first) / (to - from));
      this.windows.set(key, this.ask("trace", { name: signal.full, from: first, to: last, columns: count }).then(async answer => {
        const numbers = new Float64Array(await answer.arrayBuffer());
        const half = (numbers.length - 1) / 2;
        return { raw: numbers[0] === 1, t: numbers.subarray(1, 1 + half), v: numbers.subarray(1 + half) };
      }));
    }
    return this.windows.get(key);
  }

  async values(signals, t) {
    if (!signals.length) return [];
    const answer = await this.ask("values", { t: Math.round(t), names: signals.map(signal => signal.full).join(",") });
    return (await answer.json()).map(value => value ?? NaN);
  }

  async select(text) {
    parseFilter(text, this.head);
    const answer = await this.ask("select", { filter: text });
    this.tiles.clear();
    return { filter: text, count: (await answer.json()).count };
  }

  async rowAt(selection, t) {
    const answer = await this.ask("at", { filter: selection.filter, t: Math.round(t) });
    return (await answer.json()).row;
  }

  async rows(selection, first, count) {
    const tiles = [];
    for (let tile = Math.floor(first / TILE_ROWS); tile * TILE_ROWS < Math.min(selection.count, first + count); tile++)
      tiles.push(this.tile(selection, tile));
    const all = (await Promise.all(tiles)).flat(), start = Math.floor(first / TILE_ROWS) * TILE_ROWS;
    return all.slice(first - start, first - start + count);
  }

  tile(selection, tile) {
    const key = `${selection.filter} ${tile}`;
    if (!this.tiles.has(key)) {
      if (this.tiles.size > 60) this.tiles.clear();
      this.tiles.set(key, this.ask("rows", { filter: selection.filter, first: tile * TILE_ROWS, count: TILE_ROWS })
        .then(answer => answer.json()).then(rows => rows.map(row => this.row(row))));
    }
    return this.tiles.get(key);
  }

  row([row, t, number, flags, channel, length, data, before, gap, verdict, cycle]) {
    return {
      row, t, message: this.head.messages[number], flags, channel: this.head.frames.channels[channel] ?? "", length,
      data: bytesOf(data), before: before === null ? null : bytesOf(before), gap: gap ?? NaN, verdict, cycle,
    };
  }
}

function bytesOf(text) { return Uint8Array.from(text.match(/../g) || [], pair => parseInt(pair, 16)); }
