//! Telegrams of the tag reader: docs/reference/serial_interface.md of the bench.

const FLAG: u8 = 0x7E;
const ESCAPE: u8 = 0x7D;
const TURNED: u8 = 0x20;
const STUFFED_MAX: usize = 254;
const TAG_BYTES: usize = 23;

/// Number of a tag, and the counter of tacho A when the antenna was over it.
pub struct Tag {
    pub id: u32,
    pub pulses: u16,
}

#[derive(Default)]
pub struct TagParser {
    pub damaged: u32,
    content: Option<Vec<u8>>,
    sequence: Option<u8>,
}

impl TagParser {
    pub fn take(&mut self, data: &[u8]) -> Vec<Tag> {
        let mut found = Vec::new();
        for &byte in data {
            if byte == FLAG {
                if let Some(stuffed) = self.content.replace(Vec::new()) {
                    found.extend(self.finish(&stuffed));
                }
            } else if let Some(content) = self.content.as_mut() {
                if content.len() < STUFFED_MAX {
                    content.push(byte);
                }
            }
        }
        found
    }

    fn finish(&mut self, stuffed: &[u8]) -> Option<Tag> {
        if stuffed.is_empty() {
            return None;
        }
        let content = unstuffed(stuffed).filter(|content| is_whole(content));
        self.damaged += u32::from(content.is_none());
        let content = content?;
        if content[0] != 1 || self.sequence == Some(content[2]) {
            return None;
        }
        self.sequence = Some(content[2]);
        if content[1] != 1 || content.len() < TAG_BYTES {
            return None;
        }
        let number = |at: usize, bytes: usize| {
            content[at..at + bytes].iter().fold(0u32, |word, byte| word << 8 | u32::from(*byte))
        };
        Some(Tag { id: number(4, 4), pulses: number(16, 2) as u16 })
    }
}

fn unstuffed(stuffed: &[u8]) -> Option<Vec<u8>> {
    let (mut content, mut escaped) = (Vec::new(), false);
    for &byte in stuffed {
        if escaped {
            if byte != FLAG ^ TURNED && byte != ESCAPE ^ TURNED {
                return None;
            }
            content.push(byte ^ TURNED);
            escaped = false;
        } else if byte == ESCAPE {
            escaped = true;
        } else {
            content.push(byte);
        }
    }
    (!escaped).then_some(content)
}

fn is_whole(content: &[u8]) -> bool {
    if content.len() < 7 {
        return false;
    }
    let (body, code) = content.split_at(content.len() - 4);
    let mut crc = !0u32;
    for byte in body {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 != 0 { 0xEDB8_8320 } else { 0 };
        }
    }
    (!crc).to_be_bytes() == code
}
