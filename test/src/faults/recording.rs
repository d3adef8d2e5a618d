//! A disk that fills up during a recording: `volant record` writes to a file system of 2 MiB.

use super::{
    Action, Bench, Row,
    table::{action, row},
};
use crate::live::processes::executables;
use anyhow::{Result, anyhow};
use bag::{BagError, BagReader};
use std::{
    cell::RefCell,
    fmt::Display,
    io::Read,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    rc::Rc,
    time::Duration,
};

/// Size of the disk; the rig's topics fill it within two seconds.
const SIZE: &str = "size=2m";

/// The disk and the recorder while the row runs.
struct Recorder {
    child: Child,
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
    let recorder = Rc::new(RefCell::new(None));
    let begin: Action = {
        let recorder = Rc::clone(&recorder);
        action(move |b| {
            *recorder.borrow_mut() = Some(start(b)?);
            Ok(())
        })
    };
    let end = action(move |b| {
        if let Some(recorder) = recorder.borrow_mut().take() {
            finish(recorder, b);
        }
        Ok(())
    });
    row("disk full while `volant record` writes", None, begin, end, 0.2)
}

fn start(b: &mut Bench<'_>) -> Result<Recorder> {
    let folder = b.run.folder.join("full");
    let disk = Disk::mount(&folder)?;
    let path = executables().join("volant");
    let child = Command::new(&path)
        .args(["record", "--all", "--out"])
        .arg(folder.join("run.mcap"))
        .env("ROS_DOMAIN_ID", b.run.domain().to_string())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| anyhow!("{}: {error}", path.display()))?;
    Ok(Recorder { child, disk })
}

/// Asserts that it ended by itself with status 1 and one line that names the file, and that its bag
/// is readable.
fn finish(mut recorder: Recorder, b: &mut Bench<'_>) {
    for _ in 0..100 {
        if matches!(recorder.child.try_wait(), Ok(Some(_))) {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let status = match recorder.child.try_wait() {
        Ok(Some(status)) => status,
        _ => {
            let _ = recorder.child.kill();
            let _ = recorder.child.wait();
            b.notes.failures.push("the recorder went on though the disk was full".to_owned());
            return;
        }
    };
    let mut words = String::new();
    if let Some(mut stderr) = recorder.child.stderr.take() {
        let _ = stderr.read_to_string(&mut words);
    }
    let last = words.lines().last().unwrap_or_default().to_owned();
    if status.code() != Some(1) || !last.contains("run.mcap") {
        b.notes.failures.push(format!("the recorder ended with {status} and wrote `{last}`"));
    }
    b.notes.report = Some(last.replace(&format!("{}/", recorder.disk.0.display()), ""));
    let bag = recorder.disk.0.join("run.mcap");
    match readable(&bag) {
        Ok(count) if count < 100 => {
            b.notes
                .failures
                .push(format!("only {count} messages of the full disk's bag can be read"));
        }
        Ok(_) => {}
        Err(error) => b.notes.failures.push(format!("the full disk's bag is unreadable: {error}")),
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
