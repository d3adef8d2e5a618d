//! Folder for the logs and outputs of a run of the simulated rig.
//!
//! A run leaves the list of what it wrote, with sizes and times, in `.volant-run`. The next run in
//! the same folder removes what is on that list and unchanged; where the folder holds anything else
//! it removes nothing and ends.

use anyhow::{Result, anyhow, ensure};
use std::{
    collections::BTreeSet,
    fmt::Write as _,
    fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

const LIST: &str = ".volant-run";

/// Folder of a run; its list is written when this is dropped, or by [`write_lists`].
#[derive(Debug)]
pub struct RunFolder(PathBuf);

static RUNNING: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

impl RunFolder {
    /// Creates the folder, or empties it of what an earlier run wrote.
    pub fn create(path: &Path) -> Result<Self> {
        let failed = |path: &Path, error: &io::Error| {
            anyhow!("{}: {error}; check its folder and the permissions", path.display())
        };
        fs::create_dir_all(path).map_err(|e| failed(path, &e))?;
        let list = fs::read_to_string(path.join(LIST)).unwrap_or_default();
        let listed: BTreeSet<&str> = list.lines().collect();
        let (mut files, mut folders) = (vec![], vec![]);
        walk_run(path, &mut files, &mut folders).map_err(|e| failed(path, &e))?;
        for file in &files {
            ensure!(
                entry(path, file).is_some_and(|entry| listed.contains(entry.as_str())),
                "{}: it is not from an earlier run, or was changed since; nothing is removed: give \
                 --out an empty or new folder",
                file.display()
            );
        }
        for file in &files {
            fs::remove_file(file).map_err(|e| failed(file, &e))?;
        }
        // The innermost first.
        for folder in folders.iter().rev() {
            fs::remove_dir(folder).map_err(|e| failed(folder, &e))?;
        }
        running().insert(path.to_owned());
        Ok(Self(path.to_owned()))
    }

    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        write_list(&self.0);
        running().remove(&self.0);
    }
}

/// Writes the lists of all runs that have not ended, before the process does.
pub fn write_lists() {
    running().iter().for_each(|folder| write_list(folder));
}

fn running() -> std::sync::MutexGuard<'static, BTreeSet<PathBuf>> {
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Writes the list of a folder. Where that fails, the next run finds files without a list.
fn write_list(folder: &Path) {
    let (mut files, mut text) = (vec![], String::new());
    if walk_run(folder, &mut files, &mut vec![]).is_ok() {
        for line in files.iter().filter_map(|file| entry(folder, file)) {
            let _ = writeln!(text, "{line}");
        }
        let _ = fs::write(folder.join(LIST), text);
    }
}

/// Size, time of change and relative name of a file.
fn entry(folder: &Path, file: &Path) -> Option<String> {
    let there = fs::symlink_metadata(file).ok()?;
    let name = file.strip_prefix(folder).ok()?.to_str()?;
    Some(format!("{} {}.{:09} {name}", there.len(), there.mtime(), there.mtime_nsec()))
}

/// Collects files and folders below `folder`, without its own list; links are files.
fn walk_run(folder: &Path, files: &mut Vec<PathBuf>, folders: &mut Vec<PathBuf>) -> io::Result<()> {
    walk(folder, files, folders)?;
    // A folder in it can be that of a run that this one has started.
    files.retain(|file| *file != folder.join(LIST));
    Ok(())
}

fn walk(folder: &Path, files: &mut Vec<PathBuf>, folders: &mut Vec<PathBuf>) -> io::Result<()> {
    for item in fs::read_dir(folder)? {
        let item = item?;
        let path = item.path();
        if item.file_type()?.is_dir() {
            folders.push(path.clone());
            walk(&path, files, folders)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_an_earlier_run_wrote_is_removed() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("run");
        let run = || {
            let run = RunFolder::create(&folder)?;
            fs::create_dir(run.path().join("bag")).unwrap();
            fs::write(run.path().join("bag/metadata.yaml"), "").unwrap();
            fs::write(run.path().join("node.log"), "log").unwrap();
            drop(RunFolder::create(&run.path().join("inner")).unwrap());
            anyhow::Ok(())
        };
        run().unwrap();
        assert_eq!(fs::read_to_string(folder.join(LIST)).unwrap().lines().count(), 3);
        run().unwrap();
        // A file of the user's, in any depth, and a file that was changed.
        for (name, text) in
            [("notes.txt", "mine"), ("bag/notes.txt", "mine"), ("node.log", "mine!")]
        {
            fs::write(folder.join(name), text).unwrap();
            let error = run().unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
            assert_eq!(fs::read_to_string(folder.join(name)).unwrap(), text);
            assert!(folder.join("bag/metadata.yaml").is_file(), "nothing is removed");
            fs::remove_file(folder.join(name)).unwrap();
        }
        run().unwrap();
    }

    #[test]
    fn a_folder_of_the_users_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("bag")).unwrap();
        fs::write(place.path().join("bag/metadata.yaml"), "mine").unwrap();
        let error = RunFolder::create(place.path()).unwrap_err().to_string();
        assert!(error.contains("not from an earlier run"), "{error}");
        assert!(place.path().join("bag/metadata.yaml").is_file());
    }
}
