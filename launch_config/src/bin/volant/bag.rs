//! `volant bag`.

use crate::say;
use launch_config::bag::{BagReader, BagWriter, Compression, WriteOptions};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::Arc,
};

#[derive(clap::Subcommand)]
pub enum Action {
    /// Topics, types, counts, times
    Info {
        /// An .mcap file or a rosbag2 folder
        bag: PathBuf,
    },
    /// Makes a whole bag of all that can still be read in damaged ones
    Recover {
        /// .mcap files or rosbag2 folders, in order; a folder without metadata.yaml gives its .mcap files
        #[arg(required = true)]
        bags: Vec<PathBuf>,
        /// The bag to write: an .mcap file or a new folder
        #[arg(long, value_name = "OUT")]
        out: PathBuf,
        /// How it is compressed
        #[arg(long, value_enum, default_value = "zstd")]
        compression: Compression,
    },
}

pub fn run(action: &Action) -> anyhow::Result<()> {
    match action {
        Action::Info { bag } => info(bag),
        Action::Recover { bags, out, compression } => recover(bags, out, *compression),
    }
}

fn info(path: &Path) -> anyhow::Result<()> {
    let bag = BagReader::summary(path)?;
    for file in &bag.files {
        println!("file      {}", file.display());
    }
    println!("size      {}", say::mebibytes(bag.bytes));
    if let Some((start, end)) = bag.span {
        let seconds = |nanos: u64| format!("{}.{:09}", nanos / 1_000_000_000, nanos % 1_000_000_000);
        println!("start     {}", seconds(start));
        println!("end       {}", seconds(end));
        println!("duration  {:.3} s", (end - start) as f64 * 1e-9);
    }
    println!("messages  {}", bag.messages());
    if !bag.complete {
        println!("state     cut off or damaged: `volant bag recover` makes a whole bag of it");
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
        println!("topic     {:name$}  {:kind$}  {count:>7}{rate}", topic.name, topic.type_name);
    }
    Ok(())
}

fn recover(paths: &[PathBuf], out: &Path, compression: Compression) -> anyhow::Result<()> {
    let mut files = vec![];
    for path in paths {
        if path.is_dir() && !path.join("metadata.yaml").exists() {
            let mut found: Vec<PathBuf> = std::fs::read_dir(path)?
                .filter_map(|e| Some(e.ok()?.path()))
                .filter(|p| p.extension().is_some_and(|e| e == "mcap"))
                .collect();
            found.sort_by_key(|p| number_of(p));
            anyhow::ensure!(!found.is_empty(), "{}: no .mcap file is in this folder", path.display());
            files.extend(found);
        } else {
            files.push(path.clone());
        }
    }
    let mut writer = BagWriter::create(out, WriteOptions { compression, ..WriteOptions::default() })?;
    let mut topics = HashMap::new();
    let mut messages = 0u64;
    let mut losses = vec![];
    for file in &files {
        let mut reader = match BagReader::open(file) {
            Ok(reader) => reader,
            Err(error) => {
                losses.push(error.to_string());
                continue;
            }
        };
        while let Some(message) = reader.next_message()? {
            let key = Arc::as_ptr(&message.topic) as usize;
            // The pointer finds it quickly; the topic itself is compared where two share an address over time.
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
    let bag = writer.finish()?;
    for loss in &losses {
        say::line(&format!("volant: {loss}"));
    }
    anyhow::ensure!(messages > 0, "{}: nothing in it can be read", say::name(&paths[0]));
    println!("{messages} messages, {}, in {}", say::mebibytes(bag.bytes), out.display());
    Ok(())
}

/// `name_12.mcap` → 12, so that 10 comes after 9.
fn number_of(path: &Path) -> (u64, PathBuf) {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let digits: String = stem.chars().rev().take_while(char::is_ascii_digit).collect();
    let number = digits.chars().rev().collect::<String>().parse().unwrap_or(0);
    (number, path.to_owned())
}
