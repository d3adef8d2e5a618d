//! Written bags are read by this crate and by independent readers; damaged bags yield what is left.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use bag::{BagError, BagMessage, BagReader, BagWriter, Compression, Qos, Topic, WriteOptions};
use node_kit::files::FileError;
use std::{
    fs,
    ops::Range,
    path::{Path, PathBuf},
    process::Command,
};
use tempfile::TempDir;
use test_support::place::names;
use volant_msgs::{
    cdr, msg::MarkerObservations, sensor_msgs::msg::Image, std_msgs::msg::String as Text,
};

const COUNT: u64 = 300;
const START: u64 = 1_760_000_000_000_000_000;

/// Texts and images that fill several chunks.
fn write(path: &Path, options: WriteOptions) {
    let mut bag = BagWriter::create(path, options).unwrap();
    let text = bag.add_topic(Topic::of::<Text>("/text", &Qos::RELIABLE));
    let image = bag.add_topic(Topic::of::<Image>("/image", &Qos::SENSOR));
    let markers = bag.add_topic(Topic::of::<MarkerObservations>("/markers", &Qos::LATCHED));
    for i in 0..COUNT {
        let time = START + i * 10_000_000;
        bag.write_message(text, time, &Text { data: format!("message {i}") }).unwrap();
        if i % 10 == 0 {
            let data =
                (0..60_000u32).map(|k| (k.wrapping_mul(2_654_435_761) >> (i % 17)) as u8).collect();
            let frame = Image {
                width: 200,
                height: 100,
                step: 600,
                encoding: "rgb8".into(),
                data,
                ..Image::default()
            };
            bag.write_message(image, time, &frame).unwrap();
        }
    }
    bag.write_message(markers, START + COUNT * 10_000_000, &MarkerObservations::default()).unwrap();
    let summary = bag.finish().unwrap();
    if options.keep.is_none() {
        assert_eq!(summary.messages(), COUNT + COUNT / 10 + 1);
    }
}

fn read(path: &Path) -> (Vec<BagMessage>, Vec<String>) {
    let mut bag = BagReader::open(path).unwrap();
    let mut messages = vec![];
    while let Some(message) = bag.next_message().unwrap() {
        messages.push(message);
    }
    (messages, bag.losses().to_vec())
}

fn texts(messages: &[BagMessage]) -> Vec<String> {
    messages
        .iter()
        .filter(|m| m.topic.name == "/text")
        .map(|m| cdr::from_bytes::<Text>(&m.data).unwrap().data)
        .collect()
}

fn written(numbers: Range<u64>) -> Vec<String> {
    numbers.map(|i| format!("message {i}")).collect()
}

fn all_forms() -> impl Iterator<Item = (&'static str, WriteOptions)> {
    let split = |split_bytes, split_nanos| WriteOptions {
        split_bytes,
        split_nanos,
        ..WriteOptions::default()
    };
    let compressed =
        |compression| WriteOptions { compression, chunk_bytes: 200_000, ..WriteOptions::default() };
    [
        ("none.mcap", compressed(Compression::None)),
        ("lz4.mcap", compressed(Compression::Lz4)),
        ("zstd.mcap", compressed(Compression::Zstd)),
        ("folder", compressed(Compression::Zstd)),
        ("by_size", split(Some(500_000), None)),
        ("by_time", split(None, Some(1_000_000_000))),
    ]
    .into_iter()
}

#[test]
fn written_bags_are_read_in_every_form() {
    let dir = TempDir::new().unwrap();
    for (name, options) in all_forms() {
        let path = dir.path().join(name);
        write(&path, options);
        let (messages, losses) = read(&path);
        assert_eq!(losses, [] as [String; 0], "{name}");
        assert_eq!(texts(&messages), written(0..COUNT), "{name}");
        let first = &messages[0];
        assert_eq!(first.topic.definition, "string data\n");
        assert!(first.topic.type_hash.starts_with("RIHS01_"));
        assert!(messages.is_sorted_by_key(|m| m.log_time));
        let summary = BagReader::summary(&path).unwrap();
        assert!(summary.complete);
        assert_eq!(summary.count("/text"), COUNT);
        assert_eq!(summary.span, Some((START, START + COUNT * 10_000_000)), "{name}");
        match name {
            "by_size" => assert!(summary.files.len() >= 3, "{:?}", summary.files),
            "by_time" => assert_eq!(summary.files.len(), 4, "0 to 3 s, in files of 1 s"),
            _ => assert_eq!(summary.files.len(), 1),
        }
    }
}

#[test]
fn the_same_messages_make_the_same_bytes() {
    let dir = TempDir::new().unwrap();
    let bytes = ["a", "another"].map(|name| {
        let path = dir.path().join(name).with_extension("mcap");
        write(&path, WriteOptions::default());
        fs::read(path).unwrap()
    });
    assert!(bytes[0] == bytes[1]);
}

/// Independent readers accept each form: PyPI `rosbags` and `mcap-ros2-support`.
#[test]
fn other_readers_accept_written_bags() {
    let Some(python) = test_support::python("rosbags") else { return };
    let dir = TempDir::new().unwrap();
    let names: Vec<PathBuf> = all_forms()
        .map(|(name, options)| {
            let path = dir.path().join(name);
            write(&path, options);
            path
        })
        .collect();
    let output = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_bags.py"))
        .args(&names)
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{printed}{}", String::from_utf8_lossy(&output.stderr));
    let expected = format!(
        "/image {} /markers 1 /text {COUNT} first 'message 0' last 'message {}'",
        COUNT / 10,
        COUNT - 1
    );
    // Lone files are read by both, folders by rosbags.
    assert_eq!(printed.lines().filter(|l| l.ends_with(&expected)).count(), 3 * 2 + 3, "{printed}");
}

/// Bags of an independent writer, PyPI `rosbags`; its SQLite bags are rejected with a remedy.
#[test]
fn bags_of_other_writers_are_read() {
    let Some(python) = test_support::python("rosbags") else { return };
    let dir = TempDir::new().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/write_bags.py");
    let output = Command::new(python).arg(script).arg(dir.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["plain", "zstd_chunks", "lz4_chunks", "zstd_file", "unchunked.mcap"] {
        let (messages, losses) = read(&dir.path().join(name));
        assert_eq!(losses, [] as [String; 0], "{name}");
        assert_eq!(texts(&messages), written(0..50), "{name}");
    }
    let error = BagReader::open(&dir.path().join("sqlite")).unwrap_err().to_string();
    assert!(error.contains("sqlite3") && error.contains("ros2 bag convert"), "{error}");
}

#[test]
fn a_bag_that_is_cut_yields_all_before_the_cut_and_reports_the_loss() {
    let dir = TempDir::new().unwrap();
    for (name, options) in all_forms().take(3) {
        let whole = dir.path().join(name);
        write(&whole, options);
        let bytes = fs::read(&whole).unwrap();
        let (all, _) = read(&whole);
        let mut before = 0;
        for share in 1..20 {
            let cut = dir.path().join("cut.mcap");
            fs::write(&cut, &bytes[..bytes.len() * share / 20]).unwrap();
            let (messages, losses) = read(&cut);
            assert!(
                messages.len() >= before && messages.iter().zip(&all).all(|(a, b)| a == b),
                "{name} {share}"
            );
            assert_eq!(losses.len(), 1, "{name} {share}: {losses:?}");
            assert!(losses[0].contains("cut.mcap"), "{losses:?}");
            // All records of an uncompressed chunk before the cut are read, except the last.
            if name == "none.mcap" {
                let bytes: usize = messages.iter().map(|m| m.data.len() + 31).sum();
                assert!(
                    bytes as f64 > 0.97 * (fs::metadata(&cut).unwrap().len() as f64 - 70_000.0),
                    "{share}"
                );
            }
            assert!(!BagReader::summary(&cut).unwrap().complete);
            before = messages.len();
        }
        assert!(before > all.len() / 2);
    }
}

/// The first chunk alone announces the channels; the closing records repeat them.
#[test]
fn a_damaged_chunk_costs_its_own_messages_only() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("bag.mcap");
    let (none, zstd) = (Compression::None, Compression::Zstd);
    for (compression, at, cut) in [(zstd, 0.5, 1.0), (none, 0.01, 1.0), (none, 0.01, 0.8)] {
        let _ = fs::remove_file(&path);
        write(&path, WriteOptions { compression, chunk_bytes: 200_000, ..WriteOptions::default() });
        let (all, _) = read(&path);
        let mut bytes = fs::read(&path).unwrap();
        let at = (at * bytes.len() as f64) as usize;
        bytes[at..at + 20].fill(0xa5);
        bytes.truncate((cut * bytes.len() as f64) as usize);
        fs::write(&path, bytes).unwrap();
        let (messages, losses) = read(&path);
        assert_eq!(losses.len(), if cut < 1.0 { 2 } else { 1 }, "{losses:?}");
        assert!(losses[0].contains("damaged"), "{losses:?}");
        let (count, all_count) = (messages.len(), all.len());
        assert!(count < all_count && count > all_count / 2, "{at}: {count} of {all_count}");
        assert!(cut < 1.0 || messages.last() == all.last());
        // Known to a reader that ends before the bag does.
        let mut bag = BagReader::open(&path).unwrap();
        (0..count * 3 / 4).for_each(|_| drop(bag.next_message().unwrap()));
        assert!(bag.losses().iter().any(|loss| loss.contains("damaged")), "{:?}", bag.losses());
    }
}

#[test]
fn a_compressed_file_that_is_damaged_is_read_up_to_the_damage() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("bag.mcap");
    write(&path, WriteOptions { compression: Compression::None, ..WriteOptions::default() });
    let mut bytes = zstd::encode_all(fs::File::open(&path).unwrap(), 1).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 1000].fill(0xa5);
    let compressed = dir.path().join("bag.mcap.zstd");
    fs::write(&compressed, bytes).unwrap();
    let (messages, losses) = read(&compressed);
    assert!(!messages.is_empty() && !losses.is_empty(), "{losses:?}");
    assert!(losses.iter().all(|loss| loss.contains("bag.mcap.zstd")), "{losses:?}");
}

#[test]
fn messages_come_in_the_order_of_their_log_times() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("bag.mcap");
    let mut bag =
        BagWriter::create(&path, WriteOptions { chunk_bytes: 1000, ..WriteOptions::default() })
            .unwrap();
    let topic = bag.add_topic(Topic::of::<Text>("/text", &Qos::RELIABLE));
    // Each pair is exchanged, and each tenth comes twice with the same time.
    for i in 0..500u64 {
        let time = (i ^ 1) * 100;
        bag.write_message(topic, time, &Text { data: format!("{time} a") }).unwrap();
        if i % 10 == 0 {
            bag.write_message(topic, time, &Text { data: format!("{time} b") }).unwrap();
        }
    }
    bag.finish().unwrap();
    let (messages, _) = read(&path);
    assert_eq!(messages.len(), 550);
    assert!(messages.is_sorted_by_key(|m| m.log_time));
    for pair in
        texts(&messages).windows(2).filter(|p| p[0].split(' ').next() == p[1].split(' ').next())
    {
        assert!(
            pair[0].ends_with('a') && pair[1].ends_with('b'),
            "equal times keep the order of the file: {pair:?}"
        );
    }
}

#[test]
fn foreign_files_are_rejected_with_a_remedy() {
    let dir = TempDir::new().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    for (path, words) in [
        (dir.path().join("nothing.mcap"), "no such file"),
        (file("empty.mcap", b""), "empty"),
        (file("short.mcap", b"\x89MC"), "few bytes"),
        (file("old.bag", b"#ROSBAG V2.0\n123"), "ROS 1"),
        (file("data.db3", b"SQLite format 3\0"), "ros2 bag convert"),
        (file("image.mcap", &[0xff; 100]), "not MCAP's"),
        (dir.path().to_owned(), "metadata.yaml"),
    ] {
        let error = BagReader::open(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains(&*path.display().to_string()), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
    fs::write(
        dir.path().join("metadata.yaml"),
        "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  relative_file_paths: \
         [gone.mcap]\n",
    )
    .unwrap();
    let error = BagReader::open(dir.path()).unwrap_err().to_string();
    assert!(error.contains("gone.mcap") && error.contains("recover"), "{error}");
    let exists = BagWriter::create(&file("there.mcap", b"x"), WriteOptions::default()).unwrap_err();
    assert!(matches!(exists, BagError::Output(FileError::Exists { .. })));
    // Without the ending a bag is a folder: no option replaces a file by it.
    let options = WriteOptions { replace: true, ..WriteOptions::default() };
    let error = BagWriter::create(&file("there", b"x"), options).unwrap_err().to_string();
    assert!(error.contains("ends with .mcap") && !error.contains("overwrite"), "{error}");
}

#[test]
fn a_bag_appears_when_it_is_finished_and_a_recording_from_its_start() {
    let dir = TempDir::new().unwrap();
    for name in ["lone.mcap", "folder"] {
        let path = dir.path().join(name);
        let usual = WriteOptions::default();
        drop(BagWriter::create(&path, usual).unwrap());
        assert_eq!(names(dir.path()), [] as [&str; 0], "of an unfinished bag nothing is left");
        write(&path, usual);
        assert_eq!(names(dir.path()), [name]);
        assert!(BagReader::summary(&path).unwrap().files.iter().all(|f| f.starts_with(&path)));
        let before = read(&path);
        let again = BagWriter::create(&path, usual).unwrap_err().to_string();
        assert!(again.contains("exists already"), "{again}");
        let replace = BagWriter::create(&path, WriteOptions { replace: true, ..usual });
        assert_eq!(replace.is_ok(), name == "lone.mcap", "a folder is never replaced");
        drop(replace);
        assert!(read(&path) == before);
        let _ = fs::remove_dir_all(&path).or_else(|_| fs::remove_file(&path));
        let mut recording =
            BagWriter::create(&path, WriteOptions { in_place: true, ..usual }).unwrap();
        let topic = recording.add_topic(Topic::of::<Text>("/text", &Qos::RELIABLE));
        recording.write_message(topic, START, &Text { data: "one".into() }).unwrap();
        recording.flush().unwrap();
        drop(recording);
        assert_eq!(texts(&read(&path).0), ["one"], "{name}");
        let _ = fs::remove_dir_all(&path).or_else(|_| fs::remove_file(&path));
    }
}

#[test]
fn only_the_newest_files_are_kept_and_counted() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("kept");
    let options =
        WriteOptions { split_nanos: Some(1_000_000_000), keep: Some(2), ..WriteOptions::default() };
    // Of somebody else, in the same folder.
    let foreign = dir.path().join("kept_0.mcap");
    fs::write(&foreign, "foreign").unwrap();
    write(&path, options);
    let (messages, losses) = read(&path);
    assert_eq!(losses, [] as [String; 0]);
    // 0 to 3 s, in files of 1 s: the third of four and the last.
    assert_eq!(texts(&messages), written(200..COUNT));
    let summary = BagReader::summary(&path).unwrap();
    assert!(summary.complete);
    assert_eq!((summary.files.len(), summary.count("/text")), (2, COUNT - 200));
    assert_eq!(names(&path), ["kept_2.mcap", "kept_3.mcap", "metadata.yaml"]);
    assert_eq!(fs::read_to_string(foreign).unwrap(), "foreign");
}

/// Its message has the reason, which a `source` would print twice (`{:#}` of `anyhow`).
#[test]
fn an_error_of_the_system_has_no_source() {
    let dir = TempDir::new().unwrap();
    fs::create_dir(dir.path().join("metadata.yaml")).unwrap();
    let error = BagReader::open(dir.path()).unwrap_err();
    assert!(matches!(error, BagError::Io { .. }), "{error}");
    assert!(std::error::Error::source(&error).is_none(), "{error}");
}
