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

/// Footer record (head, two positions, checksum) and the magic after it, bytes.
const CLOSING: u64 = 9 + 20 + 8;

/// Reads the closing records of a file; `None` where they are missing, damaged or incomplete (then
/// the whole file must be read).
pub(crate) fn read_summary(path: &Path) -> Option<BagSummary> {
    let (mut file, size) = open(path)?;
    summary_of(&mut file, size)
}

fn open(path: &Path) -> Option<(File, u64)> {
    let file = File::open(path).ok()?;
    let size = file.metadata().ok()?.len();
    Some((file, size))
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
    let count = |id: u16| counts.get(&id).copied().unwrap_or(0);
    // A writer may leave out the channels or their counts.
    let counted = listed.keys().fold(0, |sum: u64, id| sum.saturating_add(count(*id)));
    // An end before the start is damage.
    (start <= end && counted == messages).then_some(())?;
    let topics =
        listed.values().map(|channel| (channels.topic_of(channel), count(channel.id))).collect();
    let span = (messages > 0).then_some((start, end));
    Some(BagSummary { topics, span, bytes: size, complete: true, ..BagSummary::default() })
}

/// Reads the schemas and channels that the closing records of an input of `size` bytes repeat; none
/// where the closing records are missing.
pub(crate) fn channels_of(file: &mut (impl Read + Seek), size: u64) -> Channels {
    let mut channels = Channels::default();
    let section = closing_section(file, size).unwrap_or_default();
    // A damaged one is left out: the chunks have it too.
    let _ = channels.records(&section, &mut vec![]);
    channels
}

/// Whether a file ends with MCAP's footer, which one that was cut off lacks.
pub(crate) fn has_footer(path: &Path) -> bool {
    open(path).and_then(|(mut file, size)| summary_start(&mut file, size)).is_some()
}

/// The bytes of the closing records.
fn closing_section(file: &mut (impl Read + Seek), size: u64) -> Option<Vec<u8>> {
    let start = summary_start(file, size)?;
    let footer_at = size - CLOSING;
    (1..=footer_at).contains(&start).then_some(())?;
    read_at(file, start, (footer_at - start).min(LARGEST_RECORD as u64))
}

/// Where the closing records start, bytes, from the footer; 0 where there are none before it.
fn summary_start(file: &mut (impl Read + Seek), size: u64) -> Option<u64> {
    let closing = read_at(file, size.checked_sub(CLOSING)?, CLOSING)?;
    let footer = closing
        .strip_prefix(&[op::FOOTER])?
        .strip_suffix(mcap::MAGIC)?
        .strip_prefix(&20_u64.to_le_bytes())?;
    Some(u64::from_le_bytes(*footer.first_chunk()?))
}

fn read_at(file: &mut (impl Read + Seek), at: u64, length: u64) -> Option<Vec<u8>> {
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut bytes = vec![];
    file.take(length).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 == length).then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BagReader;

    /// Whole files without the closing records that a summary needs are read instead.
    #[test]
    fn closing_records_without_channels_do_not_hide_the_messages() {
        let dir = tempfile::tempdir().unwrap();
        for (name, repeat_channels, emit_statistics) in
            [("no_channels.mcap", false, true), ("no_statistics.mcap", true, false)]
        {
            let path = dir.path().join(name);
            let mut writer = mcap::WriteOptions::new()
                .repeat_channels(repeat_channels)
                .emit_statistics(emit_statistics)
                .create(File::create(&path).unwrap())
                .unwrap();
            let schema =
                writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data").unwrap();
            let channel = writer.add_channel(schema, "/text", "cdr", &BTreeMap::new()).unwrap();
            for time in [4, 9] {
                let header = mcap::records::MessageHeader {
                    channel_id: channel,
                    sequence: 0,
                    log_time: time,
                    publish_time: time,
                };
                writer.write_to_known_channel(&header, b"message").unwrap();
            }
            writer.finish().unwrap();
            let summary = BagReader::summary(&path).unwrap();
            assert_eq!((summary.count("/text"), summary.span), (2, Some((4, 9))), "{name}");
            assert!(summary.complete, "{name}");
        }
    }
}
