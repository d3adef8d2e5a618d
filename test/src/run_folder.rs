//! Folder for the logs and outputs of a run of the simulated rig.
//!
//! A run leaves the list of what it wrote, with sizes and times, in `.volant-run`. The next run in
//! the same folder removes what is on that list and unchanged; where the folder holds anything else
//! it removes nothing and ends.

use anyhow::{Result, anyhow, ensure};
use std::{
    collections::BTreeSet,
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
        let contents = contents(path).map_err(|e| failed(path, &e))?;
        for (file, is_folder) in &contents {
            ensure!(
                *is_folder
                    || entry(path, file).is_some_and(|entry| listed.contains(entry.as_str())),
                "{}: it is not from an earlier run, or was changed since; nothing is removed: give \
                 --out an empty or new folder",
                file.display()
            );
        }
        // The innermost first.
        for (item, is_folder) in contents.iter().rev() {
            let removed = if *is_folder { fs::remove_dir(item) } else { fs::remove_file(item) };
            removed.map_err(|e| failed(item, &e))?;
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
    if let Ok(contents) = contents(folder) {
        let files = contents.iter().filter(|(_, is_folder)| !is_folder);
        let lines = files.filter_map(|(file, _)| Some(entry(folder, file)? + "\n"));
        let _ = fs::write(folder.join(LIST), lines.collect::<String>());
    }
}

/// Size, time of change and relative name of a file.
fn entry(folder: &Path, file: &Path) -> Option<String> {
    let there = fs::symlink_metadata(file).ok()?;
    let name = file.strip_prefix(folder).ok()?.to_str()?;
    Some(format!("{} {}.{:09} {name}", there.len(), there.mtime(), there.mtime_nsec()))
}

/// What is below `folder`, each folder before its contents, and whether it is a folder; without the
/// folder's own list. Links are files.
fn contents(folder: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
    let (mut found, mut unread) = (vec![], vec![folder.to_owned()]);
    while let Some(folder) = unread.pop() {
        for item in fs::read_dir(folder)? {
            let item = item?;
            let is_folder = item.file_type()?.is_dir();
            unread.extend(is_folder.then(|| item.path()));
            found.push((item.path(), is_folder));
        }
    }
    // A folder in it can be that of a run that this one has started, with a list of its own.
    found.retain(|(path, _)| *path != folder.join(LIST));
    Ok(found)
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
