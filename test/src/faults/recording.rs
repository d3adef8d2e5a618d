//! A disk that fills up during a recording: `volant record` writes to a file system of 2 MiB.

use super::{Action, Notes, Row, table::row};
use crate::live::{Node, Run};
use anyhow::{Result, anyhow};
use bag::{BagError, BagReader};
use std::{
    cell::RefCell,
    fmt::Display,
    path::{Path, PathBuf},
    process::Command,
    rc::Rc,
    time::Duration,
};

/// Size of the disk; the rig's topics fill it within two seconds.
const SIZE: &str = "size=2m";

/// The recorder and its disk while the row runs; they drop in this order.
struct Recorder {
    process: Node,
    disk: Disk,
}

/// A small file system, unmounted when it drops.
struct Disk(PathBuf);

impl Disk {
    fn mount(at: &Path) -> Result<Self> {
        let impossible = |reason: &dyn Display| {
            anyhow!("a small file system (`mount -t tmpfs`, as root): {reason}")
        };
        std::fs::create_dir_all(at).map_err(|e| impossible(&e))?;
        let output = Command::new("mount")
            .args(["-t", "tmpfs", "-o", SIZE, "tmpfs"])
            .arg(at)
            .output()
            .map_err(|e| impossible(&e))?;
        if !output.status.success() {
            return Err(impossible(&String::from_utf8_lossy(&output.stderr).trim()));
        }
        Ok(Self(at.to_owned()))
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

pub(super) fn disk_full() -> Row {
    let started = Rc::new(RefCell::new(None));
    let running = Rc::clone(&started);
    let begin: Action = Box::new(move |run, _| {
        *started.borrow_mut() = Some(start(run)?);
        Ok(())
    });
    let end: Action = Box::new(move |_, notes| {
        if let Some(recorder) = running.borrow_mut().take() {
            finish(recorder, notes);
        }
        Ok(())
    });
    row("disk full while `volant record` writes", None, begin, end, 0.2)
}

fn start(run: &Run) -> Result<Recorder> {
    let disk = Disk::mount(&run.folder.join("full"))?;
    let bag = disk.0.join("run.mcap").display().to_string();
    let words = ["record", "--all", "--out", &bag];
    let environment = [("ROS_DOMAIN_ID".to_owned(), run.domain.to_string())];
    let process = Node::start(None, "volant", &words, &environment, &run.folder)?;
    Ok(Recorder { process, disk })
}

/// Asserts that it ended by itself with status 1 and one line that names the file, and that its bag
/// is readable.
fn finish(mut recorder: Recorder, notes: &mut Notes) {
    let ended = (0..100).find_map(|_| {
        std::thread::sleep(Duration::from_millis(10));
        recorder.process.ended()
    });
    let Some(status) = ended else {
        notes.failures.push("the recorder went on though the disk was full".to_owned());
        return;
    };
    let log = std::fs::read_to_string(&recorder.process.log).unwrap_or_default();
    let last = log.lines().last().unwrap_or_default();
    if status.code() != Some(1) || !last.contains("run.mcap") {
        notes.failures.push(format!("the recorder ended with {status} and wrote `{last}`"));
    }
    notes.report = Some(last.replace(&format!("{}/", recorder.disk.0.display()), ""));
    let bag = recorder.disk.0.join("run.mcap");
    match readable(&bag) {
        Ok(count) if count < 100 => {
            notes
                .failures
                .push(format!("only {count} messages of the full disk's bag can be read"));
        }
        Ok(_) => {}
        Err(error) => notes.failures.push(format!("the full disk's bag is unreadable: {error}")),
    }
}

/// Messages that a bag gives, up to where it was cut off.
fn readable(bag: &Path) -> Result<usize, BagError> {
    let mut reader = BagReader::open(bag)?;
    let mut count = 0;
    while reader.next_message()?.is_some() {
        count += 1;
    }
    Ok(count)
}
