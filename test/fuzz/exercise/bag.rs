//! Bags: MCAP, whole, cut and damaged, from its beginning and from its closing records.

use bag::{BagReader, BagWriter, Compression, Qos, Topic, WriteOptions, qos_from_yaml};
use std::{io::Cursor, path::Path};
use volant_msgs::{nav_msgs::msg::Odometry, std_msgs::msg::String as Text};

pub const WORDS: &[&[u8]] = &[
    b"\x89MCAP0\r\n",
    b"\x01",
    b"\x02",
    b"\x03",
    b"\x04",
    b"\x05",
    b"\x06",
    b"\x0F",
    b"zstd",
    b"lz4",
    b"ros2msg",
    b"cdr",
    b"topic_type_hash",
    b"offered_qos_profiles",
];

pub fn run(data: &[u8]) {
    read(data);
    // A checksum would reject nearly every mutated chunk; zero means that there is none.
    let mut open = data.to_vec();
    if without_checksums(&mut open) {
        read(&open);
    }
}

fn read(data: &[u8]) {
    let name = Path::new("fuzzed.mcap");
    if let Some(summary) = BagReader::closing_records(&mut Cursor::new(data), data.len() as u64) {
        let _ = (summary.messages(), summary.count("/odometry"));
        assert!(summary.span.is_none_or(|(start, end)| start <= end));
    }
    let Ok(mut bag) = BagReader::from_reader(name, Cursor::new(data.to_vec())) else { return };
    while let Ok(Some(message)) = bag.next_message() {
        let _ = qos_from_yaml(&message.topic.offered_qos_profiles);
        let _ = volant_msgs::cdr::from_bytes::<Odometry>(&message.data);
    }
    assert!(bag.bytes_read() <= data.len() as u64);
}

/// Sets the checksum of each chunk to zero; whether there was one.
fn without_checksums(data: &mut [u8]) -> bool {
    let mut at = 8;
    let mut any = false;
    while let Some(head) = data.get(at..).and_then(|rest| rest.get(..9)) {
        let (opcode, length) =
            (head[0], head[1..].iter().rev().fold(0_u64, |n, b| n << 8 | u64::from(*b)));
        if opcode == 0x06
            && let Some(crc) = data.get_mut(at + 9 + 24..at + 9 + 28)
        {
            any |= crc != [0; 4];
            crc.fill(0);
        }
        let Some(next) =
            usize::try_from(length).ok().and_then(|l| at.checked_add(9)?.checked_add(l))
        else {
            break;
        };
        at = next;
    }
    any
}

pub fn seeds() -> Vec<Vec<u8>> {
    let folder = std::env::temp_dir().join(format!(
        "volant-fuzz-seeds-{}-{:?}",
        std::process::id(),
        std::thread::current().id()
    ));
    std::fs::create_dir_all(&folder).expect("a folder for the seeds");
    let mut seeds = vec![];
    for (name, compression) in
        [("none", Compression::None), ("lz4", Compression::Lz4), ("zstd", Compression::Zstd)]
    {
        let path = folder.join(format!("{name}.mcap"));
        let options = WriteOptions {
            compression,
            chunk_bytes: 600,
            replace: true,
            ..WriteOptions::default()
        };
        let mut bag = BagWriter::create(&path, options).expect("a bag");
        let odometry = bag.add_topic(Topic {
            definition: "x".into(),
            ..Topic::of::<Odometry>("/odometry", &Qos::SENSOR)
        });
        let text = bag.add_topic(Topic {
            definition: String::new(),
            ..Topic::of::<Text>("/text", &Qos::LATCHED)
        });
        for k in 0..3_u64 {
            let message = volant_msgs::cdr::to_bytes(&Odometry::default());
            bag.write(odometry, 1_000 + k, 900 + k, &message).expect("a message");
            let message = volant_msgs::cdr::to_bytes(&Text { data: "hello".into() });
            bag.write(text, 2_000 - k, 0, &message).expect("a message");
        }
        bag.finish().expect("a whole bag");
        seeds.push(std::fs::read(&path).expect("the bag"));
    }
    let _ = std::fs::remove_dir_all(folder);
    seeds.push(unchunked());
    seeds
}

/// Schema, channel and messages outside of any chunk, as a writer without chunks leaves them.
fn unchunked() -> Vec<u8> {
    fn record(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
        out.push(opcode);
        out.extend((body.len() as u64).to_le_bytes());
        out.extend(body);
    }
    fn text(out: &mut Vec<u8>, text: &str) {
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.as_bytes());
    }
    let mut out = b"\x89MCAP0\r\n".to_vec();
    let mut body = vec![];
    text(&mut body, "ros2");
    text(&mut body, "volant");
    record(&mut out, 1, &body);
    body = vec![1, 0];
    text(&mut body, "std_msgs/msg/String");
    text(&mut body, "ros2msg");
    text(&mut body, "string data");
    record(&mut out, 3, &body);
    body = vec![1, 0, 1, 0];
    text(&mut body, "/text");
    text(&mut body, "cdr");
    body.extend(0_u32.to_le_bytes());
    record(&mut out, 4, &body);
    body = vec![1, 0, 0, 0, 0, 0];
    body.extend(5_u64.to_le_bytes());
    body.extend(4_u64.to_le_bytes());
    body.extend(volant_msgs::cdr::to_bytes(&Text { data: "x".into() }));
    record(&mut out, 5, &body);
    record(&mut out, 0x0F, &[0; 4]);
    record(&mut out, 2, &[0; 20]);
    out.extend(b"\x89MCAP0\r\n");
    out
}
