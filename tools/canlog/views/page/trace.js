// A trace: samples of one signal in order of time, and a pyramid of minimum and maximum values.

const LEVEL = 64; // samples, or entries of the level below, per entry
const RAW_PER_COLUMN = 3; // maximum samples per pixel column that are drawn one by one

// First index with at[index] >= wanted (lowerBound), or > wanted (upperBound).
function lowerBound(at, wanted) {
  let low = 0, high = at.length;
  while (low < high) { const middle = (low + high) >> 1; if (at[middle] < wanted) low = middle + 1; else high = middle; }
  return low;
}
function upperBound(at, wanted) {
  let low = 0, high = at.length;
  while (low < high) { const middle = (low + high) >> 1; if (at[middle] <= wanted) low = middle + 1; else high = middle; }
  return low;
}

class Trace {
  constructor(t, v) { this.t = t; this.v = v; this.levels = null; }

  build() {
    this.levels = [];
    let low = this.v, high = this.v;
    while (low.length > LEVEL) {
      const count = Math.ceil(low.length / LEVEL), nextLow = new Float64Array(count), nextHigh = new Float64Array(count);
      for (let i = 0; i < count; i++) {
        let least = Infinity, most = -Infinity;
        for (let k = i * LEVEL, stop = Math.min(low.length, k + LEVEL); k < stop; k++) {
          if (low[k] < least) least = low[k];
          if (high[k] > most) most = high[k];
        }
        nextLow[i] = least; nextHigh[i] = most;
      }
      this.levels.push([nextLow, nextHigh]);
      low = nextLow; high = nextHigh;
    }
  }

  // Writes minimum and maximum of samples [begin, end) to `into`; NaN counts as neither.
  extremes(begin, end, into) {
    if (!this.levels) this.build();
    let low = Infinity, high = -Infinity, lows = this.v, highs = this.v;
    const take = (from, to) => {
      for (let k = from; k < to; k++) { if (lows[k] < low) low = lows[k]; if (highs[k] > high) high = highs[k]; }
    };
    for (let level = 0; ; level++) {
      const inner = Math.ceil(begin / LEVEL), outer = Math.floor(end / LEVEL);
      if (level === this.levels.length || inner >= outer) { take(begin, end); break; }
      take(begin, inner * LEVEL); take(outer * LEVEL, end);
      begin = inner; end = outer;
      [lows, highs] = this.levels[level];
    }
    into[0] = low; into[1] = high;
  }

  // Returns what draws the span in `columns` columns, with the neighbours outside of the span. Few
  // samples are returned as they are; otherwise each column gets its first, minimum, maximum and
  // last sample. A silence of more than `gap` ns breaks the line with a NaN value.
  window(from, to, columns, gap = 0) {
    const begin = lowerBound(this.t, from), end = upperBound(this.t, to);
    const low = Math.max(0, begin - 1), high = Math.min(this.t.length, end + 1);
    if (high - low <= RAW_PER_COLUMN * columns) return this.raw(low, high, gap);
    const out = { raw: false, t: [], v: [], count: end - begin }, pair = [0, 0], width = (to - from) / columns;
    const push = at => {
      if (gap && at > low && this.t[at] - this.t[at - 1] > gap) { out.t.push(this.t[at - 1]); out.v.push(NaN); }
      out.t.push(this.t[at]); out.v.push(this.v[at]);
    };
    if (low < begin) push(low);
    for (let i = begin, column = 0; i < end; column++) {
      column = Math.max(column, Math.floor((this.t[i] - from) / width));
      let next = lowerBound2(this.t, from + (column + 1) * width, i, end);
      if (next === i) next = i + 1;
      this.extremes(i, next, pair);
      const first = this.t[i], last = this.t[next - 1];
      // First, minimum, maximum, last: all in one pixel column, in an order that keeps time rising.
      push(i);
      out.t.push(first, last, last); out.v.push(pair[0], pair[1], this.v[next - 1]);
      i = next;
    }
    if (end < high) push(end);
    return out;
  }

  raw(low, high, gap) {
    const t = this.t.subarray(low, high), v = this.v.subarray(low, high);
    let silent = false;
    if (gap) for (let i = 1; i < t.length && !silent; i++) silent = t[i] - t[i - 1] > gap;
    if (!silent) return { raw: true, t, v };
    const out = { raw: true, t: [], v: [] };
    for (let i = 0; i < t.length; i++) {
      if (i && t[i] - t[i - 1] > gap) { out.t.push(t[i - 1] + gap); out.v.push(NaN); }
      out.t.push(t[i]); out.v.push(v[i]);
    }
    return out;
  }

  indexAt(t) { return upperBound(this.t, t) - 1; }
  valueAt(t) { const at = this.indexAt(t); return at < 0 ? NaN : this.v[at]; }
}

function lowerBound2(at, wanted, low, high) {
  // Spans are mostly even, so the search starts near.
  let step = 1;
  while (low + step < high && at[low + step] < wanted) step *= 2;
  high = Math.min(high, low + step + 1);
  while (low < high) { const middle = (low + high) >> 1; if (at[middle] < wanted) low = middle + 1; else high = middle; }
  return low;
}
