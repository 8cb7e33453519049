// Source of signals and frames: a log that is complete in the page, or a server.

const REMOTE_FLAG = 2, ERROR_FLAG = 4, FD_FLAG = 8, TX_FLAG = 64, LONG = 0xffffffff;
const NS = 1e9;

// Adds lookup tables to the messages, and lists all signals that can be drawn.
function prepare(head) {
  head.messages.forEach((message, number) => {
    message.number = number;
    message.byName = Object.fromEntries(message.signals.map(signal => [signal.name, signal]));
    message.idText = message.id.toString(16).toUpperCase().padStart(message.extended ? 8 : 3, "0");
    for (const signal of message.signals) {
      signal.unit = signal.unit.replace(/(m\/s)(\d)$/, (_, unit, power) => unit + "²³"[power - 2]);
      signal.full = `${message.name}.${signal.name}`;
      signal.message = message;
      signal.others = signal.others.map(other => ({ ...signal, ...other }));
      signal.gap = (message.timeout || 0) * 1e6;
      signal.byValue = new Map(Object.entries(signal.choices).map(
        ([raw, text]) => [Number(raw) * signal.scale + signal.offset, text]));
    }
  });
  const extras = head.extras.map(extra => ({
    ...extra, full: extra.name, extra: true, choices: {}, byValue: new Map(), state: false, gap: 0, comment: "",
  }));
  const signals = [...head.messages.filter(m => m.known).flatMap(m => m.signals), ...extras];
  return { signals, byFull: new Map(signals.map(signal => [signal.full, signal])) };
}

class LocalSource {
  constructor(head, block) {
    this.head = head; this.block = block; this.traces = new Map();
    if (block) this.load(head, block);
  }

  load(head, block) {
    const told = head.frames, n = this.count = told.count;
    const steps = block.column("step");
    this.t = new Float64Array(n);
    const long = new Map(told.long);
    let now = told.first;
    for (let i = 0; i < n; i++) {
      if (i) now += steps[i] === LONG ? long.get(i) : steps[i];
      this.t[i] = now;
    }
    this.group = block.column("group");
    this.flags = block.column("flags");
    this.channel = block.column("channel");
    this.verdict = block.has("verdict") ? block.column("verdict") : null;
    this.cycle = block.has("cycle") ? block.column("cycle") : null;
    this.index();
  }

  // Rows of each message, and the index of each row among those of its message.
  index() {
    const counts = new Uint32Array(this.head.messages.length);
    this.rank = new Uint32Array(this.count);
    for (let i = 0; i < this.count; i++) this.rank[i] = counts[this.group[i]]++;
    this.groups = this.head.messages.map((message, number) => {
      const group = { count: counts[number], rows: new Uint32Array(counts[number]), bytes: [], lengths: null };
      for (let k = 0; this.block.has(`byte ${number} ${k}`); k++) group.bytes.push(this.block.column(`byte ${number} ${k}`));
      if (this.block.has(`length ${number}`)) group.lengths = this.block.column(`length ${number}`);
      group.length = this.head.frames.lengths[number];
      return group;
    });
    for (let i = 0; i < this.count; i++) this.groups[this.group[i]].rows[this.rank[i]] = i;
  }

  trace(signal) {
    let trace = this.traces.get(signal.full);
    if (!trace) this.traces.set(signal.full, trace = signal.extra ? this.extra(signal) : this.decoded(signal));
    return trace;
  }

  extra(signal) {
    return new Trace(this.block.column(`${signal.full} t`), Float64Array.from(this.block.column(`${signal.full} v`)));
  }

  decoded(signal) {
    const message = signal.message, group = this.groups[message.number];
    const { values, mask } = signalColumn(message, group, signal);
    const t = new Float64Array(group.count);
    let kept = 0;
    for (let i = 0; i < t.length; i++) {
      if (mask && !mask[i]) continue;
      t[kept] = this.t[group.rows[i]]; values[kept++] = values[i];
    }
    return new Trace(t.subarray(0, kept), values.subarray(0, kept));
  }

  window(signal, from, to, columns) { return this.trace(signal).window(from, to, columns, signal.gap); }
  values(signals, t) { return signals.map(signal => this.trace(signal).valueAt(t)); }

  // Rows that pass a filter: null for all, else their numbers.
  select(text) {
    const terms = parseFilter(text, this.head);
    if (!terms.length) return { rows: null, count: this.count };
    const passes = this.head.messages.map((message, number) => this.passing(terms, message, number));
    const rows = new Uint32Array(this.count);
    let kept = 0;
    for (let i = 0; i < this.count; i++) {
      const pass = passes[this.group[i]];
      if (pass === true || (pass && pass[this.rank[i]])) rows[kept++] = i;
    }
    return { rows: rows.slice(0, kept), count: kept };
  }

  passing(terms, message, number) {
    let mask = true;
    for (const term of terms) {
      let found = term.matches(message);
      if (found && term.compare) {
        const signal = message.byName[term.signal], group = this.groups[number];
        const { values, mask: there } = signalColumn(message, group, signal);
        found = new Uint8Array(group.count);
        for (let i = 0; i < found.length; i++) found[i] = (!there || there[i]) && term.compare(values[i], signal);
      }
      mask = both(mask, term.not ? negated(found) : found);
      if (mask === false) return false;
    }
    return mask;
  }

  rowAt(selection, t) {
    if (!selection.rows) return Math.max(0, upperBound(this.t, t) - 1);
    let low = 0, high = selection.count;
    while (low < high) { const middle = (low + high) >> 1; if (this.t[selection.rows[middle]] <= t) low = middle + 1; else high = middle; }
    return Math.max(0, low - 1);
  }

  rows(selection, first, count) {
    const found = [];
    for (let at = first; at < Math.min(selection.count, first + count); at++)
      found.push(this.row(selection.rows ? selection.rows[at] : at));
    return found;
  }

  row(i) {
    const number = this.group[i], group = this.groups[number], rank = this.rank[i];
    const bytes = at => Uint8Array.from(group.bytes.slice(0, group.lengths ? group.lengths[at] : group.length), column => column[at]);
    return {
      row: i, t: this.t[i], message: this.head.messages[number], flags: this.flags[i],
      channel: this.head.frames.channels[this.channel[i]] ?? "",
      length: group.lengths ? group.lengths[rank] : group.length,
      data: bytes(rank), before: rank ? bytes(rank - 1) : null,
      gap: rank ? this.t[i] - this.t[group.rows[rank - 1]] : NaN,
      verdict: this.verdict ? this.verdict[i] : 0, cycle: this.cycle ? this.cycle[i] : 0,
    };
  }
}

function both(a, b) {
  if (a === false || b === false) return false;
  if (a === true) return b;
  if (b === true) return a;
  return a.map((pass, at) => pass & b[at]);
}
function negated(found) { return typeof found === "boolean" ? !found : found.map(pass => 1 - pass); }

const COMPARISONS = {
  ">": (a, b) => a > b, "<": (a, b) => a < b, ">=": (a, b) => a >= b, "<=": (a, b) => a <= b,
  "=": (a, b) => a === b, "==": (a, b) => a === b, "!=": (a, b) => a !== b,
};

// Terms of a filter, all of which must hold. Throws an Error with text for the user.
function parseFilter(text, head) {
  return text.trim().split(/\s+/).filter(Boolean).map(word => {
    const not = word.startsWith("-") && word.length > 1, body = not ? word.slice(1) : word;
    return { not, ...parseTerm(body, head) };
  });
}

function parseTerm(body, head) {
  const compared = /^([A-Za-z_][\w.:@-]*)(>=|<=|==|!=|=|>|<)(.+)$/.exec(body);
  if (compared) return comparison(compared[1], compared[2], compared[3], head);
  if (body.startsWith("@")) return { matches: message => (message.senders || []).some(name => alike(body.slice(1), name)) };
  const id = /^0x([0-9a-f]+)$/i.exec(body) || (/^[0-9a-f]{3}$|^[0-9a-f]{8}$/i.exec(body) && [0, body]);
  if (id) return { matches: message => message.id === parseInt(id[1], 16) };
  if (!head.messages.some(message => alike(body, message.name))) throw new Error(`no message ${body}`);
  return { matches: message => alike(body, message.name) };
}

function comparison(name, sign, text, head) {
  const [first, second] = name.split(".");
  const [group, signal] = second ? [first, second] : [null, first];
  const having = message => (!group || alike(group, message.name)) && signal in message.byName;
  if (!head.messages.some(having)) throw new Error(`no signal ${name}`);
  const number = Number(text), compare = COMPARISONS[sign];
  if (Number.isNaN(number)) {
    if (!head.messages.some(m => having(m) && Object.values(m.byName[signal].choices).includes(text)))
      throw new Error(`${text} is neither a number nor a value of ${name}`);
    return { matches: having, signal, compare: (value, spec) => compare(spec.byValue.get(value) === text, true) };
  }
  return { matches: having, signal, compare: value => compare(value, number) };
}

function alike(pattern, name) {
  if (!/[*?]/.test(pattern)) return name.toLowerCase().includes(pattern.toLowerCase());
  const escaped = pattern.replace(/[.+^${}()|[\]\\]/g, "\\$&").replace(/\*/g, ".*").replace(/\?/g, ".");
  return new RegExp(`^${escaped}$`, "i").test(name);
}
