//! Client of the bench in virtual time: docs/reference/lockstep_interface.md of the bench.
//!
//! The bench starts this program and speaks first. After `hello` both sides use the binary form.

use std::io::{BufRead, Error, ErrorKind, Read, Result, StdinLock, StdoutLock, Write};

use crate::wire::CanFrame;

/// A value of JSON.
pub enum Json {
    Null,
    Number(f64),
    Text(String),
    List(Vec<Json>),
    Table(Vec<(String, Json)>),
}

impl Json {
    pub fn of(text: &str) -> Option<Json> {
        value(&mut text.trim().chars().peekable())
    }

    /// The member of a table; `Null` without one.
    pub fn get(&self, name: &str) -> &Json {
        match self {
            Json::Table(members) => {
                members.iter().find(|(key, _)| key == name).map_or(&Json::Null, |(_, value)| value)
            }
            _ => &Json::Null,
        }
    }

    pub fn number(&self, name: &str) -> Option<f64> {
        match self.get(name) {
            Json::Number(number) => Some(*number),
            _ => None,
        }
    }

    pub fn text(&self, name: &str) -> Option<&str> {
        match self.get(name) {
            Json::Text(text) => Some(text),
            _ => None,
        }
    }

    pub fn list(&self, name: &str) -> &[Json] {
        match self.get(name) {
            Json::List(values) => values,
            _ => &[],
        }
    }
}

type Chars<'a> = std::iter::Peekable<std::str::Chars<'a>>;

fn skip(chars: &mut Chars, separators: &str) {
    while chars.peek().is_some_and(|next| next.is_whitespace() || separators.contains(*next)) {
        chars.next();
    }
}

fn value(chars: &mut Chars) -> Option<Json> {
    skip(chars, "");
    match *chars.peek()? {
        '{' => {
            chars.next();
            let mut members = Vec::new();
            loop {
                skip(chars, ",");
                if *chars.peek()? == '}' {
                    chars.next();
                    return Some(Json::Table(members));
                }
                let name = text(chars)?;
                skip(chars, ":");
                members.push((name, value(chars)?));
            }
        }
        '[' => {
            chars.next();
            let mut values = Vec::new();
            loop {
                skip(chars, ",");
                if *chars.peek()? == ']' {
                    chars.next();
                    return Some(Json::List(values));
                }
                values.push(value(chars)?);
            }
        }
        '"' => text(chars).map(Json::Text),
        _ => {
            let mut word = String::new();
            while chars.peek().is_some_and(|next| !",]}".contains(*next)) {
                word.push(chars.next()?);
            }
            Some(word.trim().parse().map_or(Json::Null, Json::Number))
        }
    }
}

fn text(chars: &mut Chars) -> Option<String> {
    let mut found = String::new();
    (chars.next()? == '"').then_some(())?;
    loop {
        match chars.next()? {
            '"' => return Some(found),
            '\\' => found.push(chars.next()?),
            letter => found.push(letter),
        }
    }
}

/// What the bench sent since the last wake-up.
pub struct Grant {
    pub now_ns: i64,
    /// The run is over: answer once more, then end.
    pub stop: bool,
    pub frames: Vec<(i64, CanFrame)>,
    pub serial: Vec<Vec<u8>>,
    pub radio: Vec<Vec<u8>>,
}

pub struct Bench<'a> {
    input: StdinLock<'a>,
    output: StdoutLock<'a>,
}

impl Bench<'_> {
    pub fn new() -> Self {
        Bench { input: std::io::stdin().lock(), output: std::io::stdout().lock() }
    }

    /// The message `hello`; None if the bench sent none.
    pub fn hello(&mut self) -> Result<Option<Json>> {
        let mut line = String::new();
        self.input.read_line(&mut line)?;
        Ok(Json::of(&line))
    }

    pub fn ready(&mut self, name: &str, next_ns: i64) -> Result<()> {
        writeln!(
            self.output,
            "{{\"type\":\"ready\",\"version\":1,\"form\":\"binary\",\"name\":\"{name}\",\
             \"next_wakeup_ns\":{next_ns}}}"
        )?;
        self.output.flush()
    }

    pub fn refuse(&mut self, reason: &str) -> Result<()> {
        writeln!(self.output, "{{\"type\":\"refuse\",\"reason\":\"{reason}\"}}")?;
        self.output.flush()
    }

    /// Wait for the next message; None when the bench has closed the connection.
    pub fn wait(&mut self) -> Result<Option<Grant>> {
        let mut head = [0; 4];
        if let Err(error) = self.input.read_exact(&mut head) {
            return if error.kind() == ErrorKind::UnexpectedEof { Ok(None) } else { Err(error) };
        }
        let mut record = vec![0; u32::from_le_bytes(head) as usize];
        self.input.read_exact(&mut record)?;
        grant_of(&mut Reader(&record)).map(Some).ok_or_else(|| Error::other("a torn record"))
    }

    /// Answer the message of `now_ns`. The bench wakes the controller again at `next_ns`.
    pub fn answer(
        &mut self,
        now_ns: i64,
        next_ns: i64,
        frames: &[CanFrame],
        radio: &[(&str, Vec<u8>)],
    ) -> Result<()> {
        let mut record = vec![0, 0, 0, 0, 3];
        record.extend(now_ns.to_le_bytes());
        record.extend(next_ns.to_le_bytes());
        record.extend((frames.len() as u16).to_le_bytes());
        record.extend([0, 0]); // The controller never writes to the tag reader.
        record.extend((radio.len() as u16).to_le_bytes());
        for frame in frames {
            record.extend((frame.id as u16).to_le_bytes());
            record.push(frame.length);
            record.extend(frame.data);
        }
        for (key, payload) in radio {
            record.extend((key.len() as u16).to_le_bytes());
            record.extend((payload.len() as u32).to_le_bytes());
            record.extend(key.as_bytes());
            record.extend(payload);
        }
        let size = record.len() as u32 - 4;
        record[..4].copy_from_slice(&size.to_le_bytes());
        self.output.write_all(&record)?;
        self.output.flush()
    }
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        if length > self.0.len() {
            return None;
        }
        let (first, rest) = self.0.split_at(length);
        self.0 = rest;
        Some(first)
    }

    fn number(&mut self, bytes: usize) -> Option<u64> {
        Some(self.take(bytes)?.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte)))
    }
}

fn grant_of(from: &mut Reader) -> Option<Grant> {
    let kind = from.number(1)?;
    let now_ns = from.number(8)? as i64;
    let stop = kind == 2;
    let mut found =
        Grant { now_ns, stop, frames: Vec::new(), serial: Vec::new(), radio: Vec::new() };
    if stop {
        return Some(found);
    }
    let (frames, chunks, messages) = (from.number(2)?, from.number(2)?, from.number(2)?);
    for _ in 0..frames {
        let at_ns = from.number(8)? as i64;
        let mut frame = CanFrame { id: from.number(2)? as u32, ..Default::default() };
        frame.length = from.number(1)? as u8;
        frame.data.copy_from_slice(from.take(8)?);
        found.frames.push((at_ns, frame));
    }
    for _ in 0..chunks {
        from.take(8)?;
        let length = from.number(4)? as usize;
        found.serial.push(from.take(length)?.to_vec());
    }
    for _ in 0..messages {
        from.take(8)?;
        let (key, length) = (from.number(2)? as usize, from.number(4)? as usize);
        from.take(key)?;
        found.radio.push(from.take(length)?.to_vec());
    }
    Some(found)
}
