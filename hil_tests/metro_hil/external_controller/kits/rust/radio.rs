//! Radio messages between train and wayside: docs/reference/radio_interface.md of the bench.

const VERSION: u8 = 3;
const REPORT: u8 = 1;
const AUTHORITY: u8 = 2;
const STATUS: u8 = 3;
const ORDERS: u8 = 4;
const BODY_AT: usize = 26;
const CODE_BYTES: usize = 16;
pub const AUTHORITY_NS: i64 = 3_000_000_000;
pub const ORDERS_NS: i64 = 5_000_000_000;

#[derive(Clone)]
pub struct Authority {
    pub term: u64,
    pub sequence: u32,
    /// Stamp of the report that it answers.
    pub echo_ns: i64,
    /// The front must never pass this chainage.
    pub end_m: f64,
}

#[derive(Clone)]
pub struct Orders {
    pub sequence: u32,
    /// Stamp of the status that they answer.
    pub echo_ns: i64,
    pub awake: bool,
    pub hold: bool,
    pub emergency: bool,
    pub doors_left: bool,
    pub doors_right: bool,
    pub platform_doors_locked: bool,
    /// Start, end and limit of each restriction.
    pub restrictions: Vec<(f64, f64, f64)>,
}

/// Values of msgpack that the messages use.
#[derive(Clone)]
pub enum Value {
    Nil,
    Bool(bool),
    Int(u64),
    Float(f64),
    List(Vec<Value>),
}

impl Value {
    fn int(&self) -> Option<u64> {
        if let Value::Int(number) = self { Some(*number) } else { None }
    }

    fn float(&self) -> Option<f64> {
        match self {
            Value::Float(number) if number.is_finite() => Some(*number),
            Value::Int(number) => Some(*number as f64),
            _ => None,
        }
    }

    fn bool(&self) -> Option<bool> {
        if let Value::Bool(truth) = self { Some(*truth) } else { None }
    }
}

#[derive(Default)]
pub struct Radio {
    pub key: Vec<u8>,
    pub database: u64,
    pub parameters: u64,
    pub train: u16,
    pub boot: u64,
    pub reports: u32,
    pub statuses: u32,
    pub refused: u32,
    pub authority: Option<Authority>,
    pub orders: Option<Orders>,
}

impl Radio {
    /// Position report: `front_min_m`, `front_max_m`, `rear_min_m`, `speed_mps`, and standstill.
    pub fn report(&mut self, now_ns: i64, places: [f64; 4], standstill: bool) -> Vec<u8> {
        self.reports += 1;
        let mut fields = vec![Value::Int(self.boot)];
        fields.extend(places.map(Value::Float));
        fields.extend([Value::Bool(standstill), Value::Int(self.parameters)]);
        self.sealed(REPORT, self.reports, now_ns, &fields)
    }

    /// Status for centre and platforms, with the fields of the document from `mode` on.
    pub fn status(&mut self, now_ns: i64, fields: Vec<Value>) -> Vec<u8> {
        self.statuses += 1;
        let mut all = vec![Value::Int(self.boot)];
        all.extend(fields);
        self.sealed(STATUS, self.statuses, now_ns, &all)
    }

    /// Take a received message; what is not valid, new and for this train is counted.
    pub fn take(&mut self, payload: &[u8], now_ns: i64) {
        if self.taken(payload, now_ns).is_none() {
            self.refused += 1;
        }
    }

    fn sealed(&self, kind: u8, sequence: u32, now_ns: i64, fields: &[Value]) -> Vec<u8> {
        let mut bytes = vec![VERSION, kind];
        bytes.extend(self.train.to_be_bytes());
        bytes.extend([0, 0]); // The wayside has the address 0.
        bytes.extend(sequence.to_be_bytes());
        bytes.extend(now_ns.to_be_bytes());
        bytes.extend(self.database.to_be_bytes());
        bytes.push(0x90 + fields.len() as u8);
        fields.iter().for_each(|field| pack(field, &mut bytes));
        let code = hmac(&self.key, &bytes);
        bytes.extend(&code[..CODE_BYTES]);
        bytes
    }

    fn taken(&mut self, payload: &[u8], now_ns: i64) -> Option<()> {
        let sealed = &payload[..payload.len().checked_sub(CODE_BYTES)?];
        let code = &payload[sealed.len()..];
        let difference = hmac(&self.key, sealed).iter().zip(code).fold(0, |sum, (a, b)| sum | a ^ b);
        if difference != 0 || sealed.len() <= BODY_AT {
            return None;
        }
        let word = |at: usize, bytes: usize| {
            sealed[at..at + bytes].iter().fold(0u64, |word, byte| word << 8 | u64::from(*byte))
        };
        let known = word(0, 1) == u64::from(VERSION) && word(2, 2) == 0;
        if !known || word(4, 2) != u64::from(self.train) || word(18, 8) != self.database {
            return None;
        }
        let mut body = &sealed[BODY_AT..];
        let Value::List(fields) = unpack(&mut body)? else {
            return None;
        };
        if !body.is_empty() || fields.first()?.int()? != self.boot {
            return None;
        }
        match word(1, 1) as u8 {
            AUTHORITY => self.take_authority(word(6, 4) as u32, &fields, now_ns),
            ORDERS => self.take_orders(word(6, 4) as u32, &fields, now_ns),
            _ => None,
        }
    }

    fn take_authority(&mut self, sequence: u32, fields: &[Value], now_ns: i64) -> Option<()> {
        let [_, term, echo, end, _, parameters] = fields else {
            return None;
        };
        let (term, echo_ns) = (term.int()?, i64::try_from(echo.int()?).ok()?);
        let newer = self
            .authority
            .as_ref()
            .map_or(true, |held| (term, sequence) > (held.term, held.sequence));
        if !newer || parameters.int()? != self.parameters || !is_of_age(echo_ns, now_ns, AUTHORITY_NS) {
            return None;
        }
        self.authority = Some(Authority { term, sequence, echo_ns, end_m: end.float()? });
        Some(())
    }

    fn take_orders(&mut self, sequence: u32, fields: &[Value], now_ns: i64) -> Option<()> {
        if fields.len() != 15 {
            return None;
        }
        let echo_ns = i64::try_from(fields[1].int()?).ok()?;
        let newer = self.orders.as_ref().map_or(true, |held| sequence > held.sequence);
        if !newer || !is_of_age(echo_ns, now_ns, ORDERS_NS) {
            return None;
        }
        let Value::List(limits) = &fields[13] else {
            return None;
        };
        let mut restrictions = Vec::new();
        for limit in limits {
            let Value::List(numbers) = limit else {
                return None;
            };
            let [start, end, limit] = &numbers[..] else {
                return None;
            };
            restrictions.push((start.float()?, end.float()?, limit.float()?));
        }
        self.orders = Some(Orders {
            sequence,
            echo_ns,
            awake: fields[2].bool()?,
            hold: fields[3].bool()?,
            emergency: fields[6].bool()?,
            doors_left: fields[10].bool()?,
            doors_right: fields[11].bool()?,
            platform_doors_locked: fields[12].bool()?,
            restrictions,
        });
        Some(())
    }
}

fn is_of_age(echo_ns: i64, now_ns: i64, most_ns: i64) -> bool {
    (0..=most_ns).contains(&(now_ns - echo_ns))
}

fn pack(value: &Value, to: &mut Vec<u8>) {
    match value {
        Value::Nil => to.push(0xC0),
        Value::Bool(truth) => to.push(if *truth { 0xC3 } else { 0xC2 }),
        Value::Int(number) => {
            to.push(0xCF);
            to.extend(number.to_be_bytes());
        }
        Value::Float(number) => {
            to.push(0xCB);
            to.extend(number.to_be_bytes());
        }
        Value::List(values) => {
            to.push(0x90 + values.len() as u8);
            values.iter().for_each(|each| pack(each, to));
        }
    }
}

fn unpack(from: &mut &[u8]) -> Option<Value> {
    let (&kind, rest) = from.split_first()?;
    *from = rest;
    match kind {
        0..=0x7F => Some(Value::Int(u64::from(kind))),
        0x90..=0x9F => (0..kind & 0x0F).map(|_| unpack(from)).collect::<Option<_>>().map(Value::List),
        0xC0 => Some(Value::Nil),
        0xC2 | 0xC3 => Some(Value::Bool(kind == 0xC3)),
        0xCB => number(from, 8).map(|bits| Value::Float(f64::from_bits(bits))),
        0xCC..=0xCF => number(from, 1 << (kind - 0xCC)).map(Value::Int),
        _ => None,
    }
}

fn number(from: &mut &[u8], bytes: usize) -> Option<u64> {
    if from.len() < bytes {
        return None;
    }
    let (first, rest) = from.split_at(bytes);
    *from = rest;
    Some(first.iter().fold(0, |word, byte| word << 8 | u64::from(*byte)))
}

/// HMAC-SHA256; the key has at most 64 bytes.
pub fn hmac(key: &[u8], data: &[u8]) -> [u8; 32] {
    let padded = |pad: u8| (0..64).map(move |at| key.get(at).unwrap_or(&0) ^ pad);
    let inner: Vec<u8> = padded(0x36).chain(data.iter().copied()).collect();
    let outer: Vec<u8> = padded(0x5C).chain(sha256(&inner)).collect();
    sha256(&outer)
}

/// The first 32 bits of the fractional part of a root of the n-th prime, as SHA-256 has them.
fn fraction(root: f64) -> u32 {
    (root.fract() * 4_294_967_296.0) as u32
}

fn sha256(data: &[u8]) -> [u8; 32] {
    let primes: Vec<u32> =
        (2..312u32).filter(|n| (2..*n).take_while(|d| d * d <= *n).all(|d| n % d != 0)).collect();
    let rounds: Vec<u32> = primes.iter().map(|n| fraction(f64::from(*n).cbrt())).collect();
    let mut state: Vec<u32> = primes[..8].iter().map(|n| fraction(f64::from(*n).sqrt())).collect();
    let mut padded = data.to_vec();
    padded.push(0x80);
    padded.resize((padded.len() + 8).next_multiple_of(64), 0);
    let end = padded.len() - 8;
    padded[end..].copy_from_slice(&(8 * data.len() as u64).to_be_bytes());
    for block in padded.chunks(64) {
        let mut words: Vec<u32> =
            block.chunks(4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]])).collect();
        for at in 16..64 {
            let (a, b) = (words[at - 15], words[at - 2]);
            let s0 = a.rotate_right(7) ^ a.rotate_right(18) ^ a >> 3;
            let s1 = b.rotate_right(17) ^ b.rotate_right(19) ^ b >> 10;
            let sum = words[at - 16].wrapping_add(words[at - 7]);
            words.push(sum.wrapping_add(s0).wrapping_add(s1));
        }
        let mut v = state.clone();
        for at in 0..64 {
            let e = v[4].rotate_right(6) ^ v[4].rotate_right(11) ^ v[4].rotate_right(25);
            let choice = v[4] & v[5] ^ !v[4] & v[6];
            let one = v[7].wrapping_add(e).wrapping_add(choice);
            let one = one.wrapping_add(rounds[at]).wrapping_add(words[at]);
            let a = v[0].rotate_right(2) ^ v[0].rotate_right(13) ^ v[0].rotate_right(22);
            let two = a.wrapping_add(v[0] & v[1] ^ v[0] & v[2] ^ v[1] & v[2]);
            v.rotate_right(1);
            v[4] = v[4].wrapping_add(one);
            v[0] = one.wrapping_add(two);
        }
        state.iter_mut().zip(&v).for_each(|(sum, each)| *sum = sum.wrapping_add(*each));
    }
    let mut code = [0; 32];
    for (at, word) in state.iter().enumerate() {
        code[4 * at..4 * at + 4].copy_from_slice(&word.to_be_bytes());
    }
    code
}
