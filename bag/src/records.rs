//! Parsers of the MCAP records that bags consist of. Layouts: the MCAP specification, "Records".
//!
//! mcap 0.26.0's `parse_record` is not used: binrw 0.15.2 reserves whatever length a text claims,
//! four gigabytes for a record of a few bytes.

use std::collections::HashMap;

/// Unread part of a record. Every method returns `None` where the record is damaged.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.0.split_off(..2)?.try_into().ok()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.0.split_off(..4)?.try_into().ok()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.0.split_off(..8)?.try_into().ok()?))
    }

    /// Bytes preceded by their length.
    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        self.0.split_off(..length)
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }
}

/// Splits the first record off: operation code, content and what follows it. `None` where the
/// record is longer than the rest.
pub(super) fn split_first(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let ([opcode, length @ ..], after) = bytes.split_first_chunk::<9>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    let (record, rest) = after.split_at_checked(length)?;
    Some((*opcode, record, rest))
}

/// Message type of a topic.
pub(super) struct Schema<'a> {
    pub id: u16,
    pub name: &'a str,
    pub encoding: &'a str,
    pub data: &'a [u8],
}

impl<'a> Schema<'a> {
    pub fn parse(record: &'a [u8]) -> Option<Self> {
        let mut f = Fields(record);
        Some(Self { id: f.u16()?, name: f.text()?, encoding: f.text()?, data: f.bytes()? })
    }
}

/// A topic.
pub(super) struct Channel<'a> {
    pub id: u16,
    pub schema: u16,
    pub topic: &'a str,
    pub message_encoding: &'a str,
    pub metadata: HashMap<&'a str, &'a str>,
}

impl<'a> Channel<'a> {
    pub fn parse(record: &'a [u8]) -> Option<Self> {
        let mut f = Fields(record);
        let (id, schema, topic, message_encoding) = (f.u16()?, f.u16()?, f.text()?, f.text()?);
        let mut entries = Fields(f.bytes()?);
        let mut metadata = HashMap::new();
        while !entries.0.is_empty() {
            metadata.insert(entries.text()?, entries.text()?);
        }
        Some(Self { id, schema, topic, message_encoding, metadata })
    }

    /// An entry of its metadata; empty where it has none.
    pub fn entry(&self, key: &str) -> String {
        self.metadata.get(key).copied().unwrap_or_default().to_owned()
    }
}

/// A message.
pub(super) struct Message<'a> {
    pub channel: u16,
    pub log_time: u64,
    pub publish_time: u64,
    pub data: &'a [u8],
}

impl<'a> Message<'a> {
    pub fn parse(record: &'a [u8]) -> Option<Self> {
        let mut f = Fields(record);
        let (channel, _sequence) = (f.u16()?, f.u32()?);
        Some(Self { channel, log_time: f.u64()?, publish_time: f.u64()?, data: f.0 })
    }
}

/// Chunk of records, compressed or not.
pub(super) struct Chunk<'a> {
    /// Claimed length of its records, decompressed, bytes.
    pub expanded_length: u64,
    /// CRC-32 of its records, decompressed; 0: none.
    pub checksum: u32,
    /// Name of the compression; empty: none.
    pub compression: &'a str,
    /// Its records; fewer bytes than claimed where the file is cut off.
    pub records: &'a [u8],
}

impl<'a> Chunk<'a> {
    pub fn parse(record: &'a [u8]) -> Option<Self> {
        let mut f = Fields(record);
        // Earliest and latest time.
        f.0.split_off(..2 * 8)?;
        let expanded_length = f.u64()?;
        let (checksum, compression, length) = (f.u32()?, f.text()?, f.u64()?);
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        let records = f.0.get(..length).unwrap_or(f.0);
        Some(Self { expanded_length, checksum, compression, records })
    }
}

/// Message counts and times of a file, ns.
pub(super) struct Statistics {
    pub messages: u64,
    pub start: u64,
    pub end: u64,
    /// Messages by channel.
    pub counts: HashMap<u16, u64>,
}

impl Statistics {
    pub fn parse(record: &[u8]) -> Option<Self> {
        let mut f = Fields(record);
        let messages = f.u64()?;
        // Schemas, channels, attachments, metadata, chunks.
        f.0.split_off(..2 + 4 * 4)?;
        let (start, end) = (f.u64()?, f.u64()?);
        let mut entries = Fields(f.bytes()?);
        let mut counts = HashMap::new();
        while !entries.0.is_empty() {
            counts.insert(entries.u16()?, entries.u64()?);
        }
        Some(Self { messages, start, end, counts })
    }
}
