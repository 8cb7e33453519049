// Decodes packed bytes into columns, and columns into physical values of a signal.

const ARRAYS = { u2: Uint16Array, u4: Uint32Array, f4: Float32Array, f8: Float64Array };
const EXACT_BYTES = 6; // bytes that a double holds exactly, with room for a shift

async function inflate(text) {
  if (!text) return new Uint8Array(0);
  let packed;
  if (Uint8Array.fromBase64) packed = Uint8Array.fromBase64(text);
  else {
    const letters = atob(text);
    packed = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
  }
  return inflateBytes(packed);
}

async function inflateBytes(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Columns by name; multi-byte items are stored with all first bytes first.
class Block {
  constructor(bytes, index) { this.bytes = bytes; this.index = index; }
  has(name) { return name in this.index; }
  column(name) {
    const [at, count, kind] = this.index[name];
    const width = Number(kind[1]);
    if (width === 1) return this.bytes.subarray(at, at + count);
    const whole = new Uint8Array(count * width);
    for (let part = 0; part < width; part++) {
      const source = at + part * count;
      for (let i = 0, to = part; i < count; i++, to += width) whole[to] = this.bytes[source + i];
    }
    return new ARRAYS[kind](whole.buffer);
  }
}

// Position of a signal's bits: first byte, number of bytes, and the right shift of their number.
function cutOf(signal) {
  const first = signal.start >> 3;
  const bit = signal.big ? 7 - (signal.start & 7) : signal.start & 7;
  const count = ((bit + signal.length - 1) >> 3) + 1;
  const down = signal.big ? 8 * count - bit - signal.length : bit;
  return { first, count, down, needed: first + count };
}

// Raw values of a column as doubles, exact up to 53 bits.
function rawColumn(group, signal) {
  const cut = cutOf(signal), n = group.count, out = new Float64Array(n);
  if (cut.needed > group.bytes.length) return out;
  if (cut.count > EXACT_BYTES) {
    for (let i = 0; i < n; i++) out[i] = Number(rawExact(signal, at => group.bytes[at][i]));
    return out;
  }
  for (let k = 0; k < cut.count; k++) {
    const byte = group.bytes[cut.first + k];
    const weight = signal.big ? 256 ** (cut.count - 1 - k) : 256 ** k;
    for (let i = 0; i < n; i++) out[i] += byte[i] * weight;
  }
  const down = 2 ** cut.down, range = 2 ** signal.length, half = signal.signed ? range / 2 : Infinity;
  for (let i = 0; i < n; i++) {
    const raw = Math.floor(out[i] / down) % range;
    out[i] = raw >= half ? raw - range : raw;
  }
  return out;
}

// Raw value of one frame, exact for all 64 bits. `byteAt` returns its bytes.
function rawExact(signal, byteAt) {
  const cut = cutOf(signal);
  let whole = 0n;
  for (let k = 0; k < cut.count; k++) {
    const byte = BigInt(byteAt(cut.first + k) ?? 0);
    whole = signal.big ? (whole << 8n) | byte : whole | (byte << BigInt(8 * k));
  }
  const raw = BigInt.asUintN(signal.length, whole >> BigInt(cut.down));
  return signal.signed && !signal.float ? BigInt.asIntN(signal.length, raw) : raw;
}

const SCRATCH = new DataView(new ArrayBuffer(8));
function floatOf(length, raw) {
  SCRATCH.setBigUint64(0, raw);
  if (length === 64) return SCRATCH.getFloat64(0);
  if (length === 32) return SCRATCH.getFloat32(4);
  const half = Number(raw), sign = half & 0x8000 ? -1 : 1, power = (half >> 10) & 31, part = half & 1023;
  if (power === 31) return part ? NaN : sign * Infinity;
  return sign * (power ? 2 ** (power - 15) * (1 + part / 1024) : 2 ** -14 * (part / 1024));
}

function physicalExact(signal, raw) {
  if (signal.float) return floatOf(signal.length, raw) * signal.scale + signal.offset;
  if (Number.isInteger(signal.scale) && Number.isInteger(signal.offset))
    return Number(raw * BigInt(signal.scale) + BigInt(signal.offset));
  return Number(raw) * signal.scale + signal.offset;
}

// Physical values of a column; `carried` says which frames carry the signal.
function physicalColumn(group, signal) {
  if (signal.float || cutOf(signal).count > EXACT_BYTES) {
    const out = new Float64Array(group.count);
    for (let i = 0; i < out.length; i++)
      out[i] = physicalExact(signal, rawExact(signal, at => group.bytes[at]?.[i]));
    return out;
  }
  const out = rawColumn(group, signal);
  if (signal.scale !== 1 || signal.offset !== 0)
    for (let i = 0; i < out.length; i++) out[i] = out[i] * signal.scale + signal.offset;
  return out;
}

// Mask of the frames that carry a signal: long enough, and selected by every multiplexer above.
// Null: all frames.
function carried(message, group, signal) {
  const needed = cutOf(signal).needed;
  let mask = null;
  if (group.lengths || needed > group.bytes.length) {
    mask = new Uint8Array(group.count);
    for (let i = 0; i < mask.length; i++) mask[i] = (group.lengths ? group.lengths[i] : group.bytes.length) >= needed;
  }
  const parent = signal.mux && message.byName[signal.mux];
  if (!parent) return mask;
  const chosen = rawColumn(group, parent), wanted = new Set(signal.muxIds);
  const above = carried(message, group, parent);
  const out = new Uint8Array(group.count);
  for (let i = 0; i < out.length; i++)
    out[i] = wanted.has(chosen[i]) && (!above || above[i]) && (!mask || mask[i]);
  return out;
}

// Values and mask of a signal, which may lie at other bits in other pages of the multiplexer.
function signalColumn(message, group, signal) {
  const values = physicalColumn(group, signal), mask = carried(message, group, signal);
  for (const other of signal.others) {
    const more = physicalColumn(group, other), there = carried(message, group, other);
    for (let i = 0; i < values.length; i++) if (!there || there[i]) { values[i] = more[i]; if (mask) mask[i] = 1; }
  }
  return { values, mask };
}

function carriedByFrame(message, signal, data) {
  if (cutOf(signal).needed > data.length) return false;
  const parent = signal.mux && message.byName[signal.mux];
  if (!parent) return true;
  return signal.muxIds.includes(Number(rawExact(parent, at => data[at]))) && carriedByFrame(message, parent, data);
}

// A value as text: its name in the value table, names of flags, or the digits that the scale needs.
function valueText(signal, value, raw) {
  const named = raw === undefined ? signal.byValue.get(value) : signal.choices[raw];
  if (named !== undefined) return named;
  const flags = raw === undefined ? "" : flagsText(signal, Number(raw));
  if (flags) return flags;
  return numberText(value, signal);
}

function numberText(value, signal) {
  if (!Number.isFinite(value)) return String(value);
  if (Math.abs(value) > Number.MAX_SAFE_INTEGER && !signal.float) return value.toPrecision(15); // further digits are not exact
  const steps = [signal.scale ?? 0, signal.offset ?? 0];
  if (signal.float || signal.extra || steps.some(step => decimals(step) > 6)) return String(Number(value.toPrecision(7)));
  return value.toFixed(Math.max(...steps.map(decimals)));
}

function decimals(number) {
  const [digits, power] = String(number).split("e-");
  return Math.max(0, (digits.split(".")[1] || "").length + Number(power || 0));
}

function flagsText(signal, raw) {
  const bits = Object.keys(signal.choices).map(Number).filter(bit => bit > 0);
  if (bits.length < 2 || raw <= 0 || bits.some(bit => bit & (bit - 1))) return "";
  if (bits.reduce((rest, bit) => rest & ~bit, raw)) return "";
  return bits.filter(bit => raw & bit).map(bit => signal.choices[bit]).join("|");
}
