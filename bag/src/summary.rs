//! Closing records of an MCAP file: its topics, message counts and times, without reading it all.
//!
//! mcap 0.26.0's `SummaryReader` is not used: it parses records with binrw 0.15.2, which reserves
//! whatever length a text claims (see [`crate::records`]).

use crate::{
    BagSummary,
    channels::Channels,
    file_reader::LARGEST_RECORD,
    records::{self, Channel, Statistics},
};
use mcap::records::op;
use std::{
    collections::BTreeMap,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::Path,
};

/// Reads the closing records of a file; `None` where they are missing or damaged (then the whole
/// file must be read).
pub(crate) fn read_summary(path: &Path) -> Option<BagSummary> {
    let mut file = File::open(path).ok()?;
    let size = file.metadata().ok()?.len();
    summary_of(&mut file, size)
}

/// Reads the closing records of an input of `size` bytes; see [`read_summary`].
pub(crate) fn summary_of(file: &mut (impl Read + Seek), size: u64) -> Option<BagSummary> {
    let section = closing_section(file, size)?;
    let mut rest = section.as_slice();
    let (mut channels, mut listed, mut statistics) = (Channels::default(), BTreeMap::new(), None);
    while rest.len() >= 9 {
        let (opcode, record, next) = records::split_first(rest)?;
        match opcode {
            op::SCHEMA => channels.record(opcode, record, &mut vec![]).ok()?,
            op::CHANNEL => {
                let channel = Channel::parse(record)?;
                listed.insert(channel.id, channel);
            }
            op::STATISTICS => statistics = Some(Statistics::parse(record)?),
            _ => {}
        }
        rest = next;
    }
    let Statistics { messages, start, end, counts } = statistics?;
    // An end before the start is damage.
    (start <= end).then_some(())?;
    let count = |id: u16| counts.get(&id).copied().unwrap_or(0);
    let topics =
        listed.values().map(|channel| (channels.topic_of(channel), count(channel.id))).collect();
    let span = (messages > 0).then_some((start, end));
    Some(BagSummary { topics, span, bytes: size, files: vec![], complete: true })
}

/// Reads the schemas and channels that the closing records of an input of `size` bytes repeat; none
/// where the closing records are missing.
pub(crate) fn channels_of(file: &mut (impl Read + Seek), size: u64) -> Channels {
    let section = closing_section(file, size).unwrap_or_default();
    let mut rest = section.as_slice();
    let mut channels = Channels::default();
    while let Some((opcode, record, next)) = records::split_first(rest) {
        if matches!(opcode, op::SCHEMA | op::CHANNEL) {
            // A damaged one is left out: the chunks have it too.
            let _ = channels.record(opcode, record, &mut vec![]);
        }
        rest = next;
    }
    channels
}

/// The bytes of the closing records.
fn closing_section(file: &mut (impl Read + Seek), size: u64) -> Option<Vec<u8>> {
    /// Footer record (head, two positions, checksum) and the magic after it.
    const CLOSING: u64 = 9 + 20 + 8;
    let footer_at = size.checked_sub(CLOSING)?;
    let closing = read_at(file, footer_at, CLOSING)?;
    let footer = closing
        .strip_prefix(&[op::FOOTER])?
        .strip_suffix(mcap::MAGIC)?
        .strip_prefix(&20_u64.to_le_bytes())?;
    let start = records::summary_start(footer).filter(|start| (1..=footer_at).contains(start))?;
    read_at(file, start, (footer_at - start).min(LARGEST_RECORD as u64))
}

fn read_at(file: &mut (impl Read + Seek), at: u64, length: u64) -> Option<Vec<u8>> {
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut bytes = vec![];
    file.take(length).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 == length).then_some(bytes)
}
