//! `volant bag`.

use crate::terminal;
use bag::{BagReader, BagWriter, Compression, WriteOptions, files_to_recover};
use node_kit::outln;
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::Arc,
};

#[derive(clap::Subcommand)]
pub enum Action {
    /// Print topics, types, message counts and times
    Info {
        /// .mcap file or rosbag2 folder
        bag: PathBuf,
    },
    /// Write all readable messages of damaged bags to a new bag
    Recover {
        /// .mcap files or rosbag2 folders, in order; of a folder the .mcap and .mcap.zstd files of
        /// the recording, with or without metadata.yaml
        #[arg(required = true)]
        bags: Vec<PathBuf>,
        /// Bag to write: an .mcap file or a new folder
        #[arg(long, value_name = "OUT")]
        out: PathBuf,
        /// Replace an existing .mcap file
        #[arg(long)]
        overwrite: bool,
        /// Compression of the new bag
        #[arg(long, value_enum, default_value = "zstd")]
        compression: Compression,
    },
}

pub fn run(action: &Action) -> anyhow::Result<()> {
    match action {
        Action::Info { bag } => info(bag),
        Action::Recover { bags, out, overwrite, compression } => {
            let options = WriteOptions {
                compression: *compression,
                replace: *overwrite,
                ..WriteOptions::default()
            };
            recover(bags, out, options)
        }
    }
}

fn info(path: &Path) -> anyhow::Result<()> {
    let bag = BagReader::summary(path)?;
    for file in &bag.files {
        outln!("file      {}", file.display())?;
    }
    outln!("size      {}", terminal::mebibytes(bag.bytes))?;
    if let Some((start, end)) = bag.span {
        let seconds =
            |nanos: u64| format!("{}.{:09}", nanos / 1_000_000_000, nanos % 1_000_000_000);
        outln!("start     {}", seconds(start))?;
        outln!("end       {}", seconds(end))?;
        outln!("duration  {:.3} s", (end - start) as f64 * 1e-9)?;
    }
    outln!("messages  {}", bag.messages())?;
    if !bag.complete {
        let remedy = match bag.messages() {
            0 => "no message is readable, so record it again",
            _ => "`volant bag recover` repairs it",
        };
        outln!("state     cut off or damaged; {remedy}")?;
    }
    let duration = bag.span.map_or(0.0, |(a, b)| (b - a) as f64 * 1e-9);
    let name = bag.topics.iter().map(|(t, _)| t.name.len()).max().unwrap_or(0);
    let kind = bag.topics.iter().map(|(t, _)| t.type_name.len()).max().unwrap_or(0);
    for (topic, count) in &bag.topics {
        let rate = if duration > 0.0 && *count > 1 {
            format!("{:>9.2} Hz", (*count - 1) as f64 / duration)
        } else {
            String::new()
        };
        outln!("topic     {:name$}  {:kind$}  {count:>7}{rate}", topic.name, topic.type_name)?;
    }
    Ok(())
}

fn recover(paths: &[PathBuf], out: &Path, options: WriteOptions) -> anyhow::Result<()> {
    let inputs: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
    BagWriter::check(out, options.replace, &inputs)?;
    let (mut files, mut losses) = (vec![], vec![]);
    for path in paths {
        let (found, notes) = files_to_recover(path)?;
        files.extend(found);
        losses.extend(notes);
    }
    let mut writer = BagWriter::create(out, options)?;
    let mut topics = HashMap::new();
    let mut messages = 0u64;
    for file in &files {
        let mut reader = match BagReader::open(file) {
            Ok(reader) => reader,
            Err(error) => {
                losses.push(error.to_string());
                continue;
            }
        };
        loop {
            let message = match reader.next_message() {
                Ok(Some(message)) => message,
                Ok(None) => break,
                // What was read before the error follows.
                Err(error) => {
                    losses.push(error.to_string());
                    continue;
                }
            };
            let key = Arc::as_ptr(&message.topic) as usize;
            // The pointer is a fast key; topics are compared too, since an address can be reused.
            let id = match topics.get(&key) {
                Some((topic, id)) if *topic == message.topic => *id,
                _ => {
                    let id = writer.add_topic((*message.topic).clone());
                    topics.insert(key, (message.topic.clone(), id));
                    id
                }
            };
            writer.write(id, message.log_time, message.publish_time, &message.data)?;
            messages += 1;
        }
        losses.extend_from_slice(reader.losses());
    }
    losses.iter().for_each(terminal::warn);
    let name = paths[0].file_name().unwrap_or(paths[0].as_os_str());
    anyhow::ensure!(
        messages > 0,
        "{}: no readable message; record it again, or give another one",
        name.display()
    );
    let bag = writer.finish()?;
    outln!("{messages} messages, {}, in {}", terminal::mebibytes(bag.bytes), out.display())?;
    Ok(())
}
