//! Files of a bag: a lone file, or those of a rosbag2 folder.

use crate::{BagError, file_reader::io_error, metadata::Folder};
use std::{
    collections::BTreeSet,
    fs::{self, File},
    io::{self, ErrorKind, Read},
    path::{Component, Path, PathBuf},
};

/// Largest `metadata.yaml` that is read, bytes: about a million files of a split recording.
const LARGEST_METADATA: u64 = 256 << 20;

/// Returns the files that a rosbag2 folder's `metadata.yaml` names, in their order.
///
/// # Errors
/// A description of what is wrong with the text: not such YAML, another storage or compression, no
/// file, or one outside of the folder.
pub fn files_named_by(metadata: &str) -> Result<Vec<String>, String> {
    let folder = Folder::parse(metadata)?;
    match not_ours(&folder) {
        Some((what, remedy)) => Err(format!("{what}; {remedy}")),
        None => own_files(folder),
    }
}

/// Returns the files of a bag that may be damaged: of a folder every MCAP file in it by its number,
/// and then the files that only its `metadata.yaml` names, which may be missing.
///
/// # Errors
/// The folder is unreadable, or has no such file.
pub fn files_to_recover(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let error = |source| io_error(path, source);
    let is_mcap = |file: &Path| {
        let name = file.to_string_lossy();
        [".mcap", ".mcap.zstd", ".mcap.zst"].into_iter().any(|ending| name.ends_with(ending))
    };
    let mut files = vec![];
    for entry in fs::read_dir(path).map_err(error)? {
        let file = entry.map_err(error)?.path();
        if is_mcap(&file) {
            files.push(file);
        }
    }
    files.sort_by_key(|file| (number_of(file), file.clone()));
    let mut known: BTreeSet<PathBuf> = files.iter().cloned().collect();
    let named = metadata_text(&path.join("metadata.yaml")).ok().map(|text| files_named_by(&text));
    for name in named.into_iter().flatten().flatten() {
        let file = path.join(name);
        if known.insert(file.clone()) {
            files.push(file);
        }
    }
    if !files.is_empty() {
        return Ok(files);
    }
    match files_of(path) {
        Err(foreign @ BagError::Foreign { .. }) => Err(foreign),
        _ => Err(BagError::unusable(path, "the folder holds no .mcap file; give another one")),
    }
}

/// Number of a split recording's file: `name_12.mcap` → 12, so that 10 comes after 9.
fn number_of(path: &Path) -> u64 {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.split(".mcap").next().unwrap_or_default();
    let digits = stem.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap_or_default();
    digits.parse().unwrap_or(0)
}

/// The `.mcap` files of a bag in their order.
pub(crate) fn files_of(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    if !fs::metadata(path).map_err(|source| io_error(path, source))?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let yaml = path.join("metadata.yaml");
    let broken = |reason: String| {
        let remedy = "`volant bag recover` repairs its .mcap files";
        BagError::unusable(&yaml, format!("{reason}; {remedy}"))
    };
    let text = match metadata_text(&yaml) {
        Ok(text) => text,
        Err(e) if e.kind() == ErrorKind::NotFound => {
            return Err(broken("is missing, so this folder is not a rosbag2 bag".into()));
        }
        Err(source) => return Err(BagError::Io { path: yaml.clone(), source }),
    };
    let folder = Folder::parse(&text).map_err(&broken)?;
    if let Some((what, remedy)) = not_ours(&folder) {
        return Err(BagError::Foreign { path: path.to_owned(), what, remedy });
    }
    let names = own_files(folder).map_err(&broken)?;
    let files: Vec<PathBuf> = names.iter().map(|name| path.join(name)).collect();
    if let Some(missing) = files.iter().find(|f| !f.exists()) {
        return Err(broken(format!("names {}, which is not there", missing.display())));
    }
    Ok(files)
}

fn metadata_text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(LARGEST_METADATA + 1).read_to_string(&mut text)?;
    if text.len() as u64 > LARGEST_METADATA {
        let mebibytes = LARGEST_METADATA >> 20;
        let reason = format!("it is larger than {mebibytes} MiB, which no metadata.yaml is");
        return Err(io::Error::new(ErrorKind::FileTooLarge, reason));
    }
    Ok(text)
}

/// Why a folder's files are not supported, and the remedy.
fn not_ours(folder: &Folder) -> Option<(String, &'static str)> {
    if folder.storage_identifier != "mcap" {
        let what = format!("its storage is `{}`", folder.storage_identifier);
        return Some((what, "convert it with `ros2 bag convert`, or record with `-s mcap`"));
    }
    let mode = folder.compression_mode.as_deref().unwrap_or_default();
    let format = folder.compression_format.as_deref().unwrap_or_default();
    if mode == "message" || !matches!(format, "" | "zstd") {
        let what =
            format!("its messages are compressed one by one, mode `{mode}`, format `{format}`");
        return Some((what, "convert it with `ros2 bag convert` without compression"));
    }
    None
}

/// The files of a folder. Bags come from other people: a name must not lead out of the folder.
fn own_files(folder: Folder) -> Result<Vec<String>, String> {
    let inside = |name: &String| {
        !name.is_empty()
            && Path::new(name)
                .components()
                .all(|c| matches!(c, Component::Normal(_) | Component::CurDir))
    };
    let files = folder.relative_file_paths;
    if files.is_empty() {
        return Err("names no file".into());
    }
    match files.iter().find(|name| !inside(name)) {
        Some(foreign) => Err(format!("names {foreign:?}, which is not a file of this folder")),
        None => Ok(files),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str =
        "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  relative_file_paths:\n";

    #[test]
    fn a_folder_names_its_own_files_only() {
        let named = |name: &str| files_named_by(&format!("{HEAD}    - {name}\n"));
        assert_eq!(named("run_0.mcap").unwrap(), ["run_0.mcap"]);
        assert_eq!(named("./a/run_0.mcap").unwrap(), ["./a/run_0.mcap"]);
        for foreign in ["/etc/passwd", "../other/run_0.mcap", "a/../../x", "''"] {
            assert!(named(foreign).unwrap_err().contains("not a file of this folder"), "{foreign}");
        }
    }

    #[test]
    fn the_metadata_of_a_long_split_recording_is_read() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("run_0.mcap"), "").unwrap();
        let text = HEAD.to_owned() + &"    - run_0.mcap\n".repeat(70_000);
        assert!(text.len() > 1 << 20);
        fs::write(dir.path().join("metadata.yaml"), text).unwrap();
        assert_eq!(files_of(dir.path()).unwrap().len(), 70_000);
    }

    #[test]
    fn every_file_of_a_folder_is_recovered_whatever_its_metadata_says() {
        let dir = tempfile::tempdir().unwrap();
        let names = || {
            let files = files_to_recover(dir.path()).unwrap();
            let relative = files.iter().map(|f| f.strip_prefix(dir.path()).unwrap());
            relative.map(|f| f.display().to_string()).collect::<Vec<_>>()
        };
        let error = files_to_recover(dir.path()).unwrap_err().to_string();
        assert!(error.contains("holds no .mcap file"), "{error}");
        for name in ["run_10.mcap", "run_9.mcap.zstd", "notes.txt"] {
            fs::write(dir.path().join(name), "").unwrap();
        }
        assert_eq!(names(), ["run_9.mcap.zstd", "run_10.mcap"]);
        let text = format!("{HEAD}    - ./run_10.mcap\n    - gone.mcap\n");
        fs::write(dir.path().join("metadata.yaml"), text).unwrap();
        assert_eq!(names(), ["run_9.mcap.zstd", "run_10.mcap", "gone.mcap"]);
        fs::write(dir.path().join("metadata.yaml"), "{").unwrap();
        assert_eq!(names(), ["run_9.mcap.zstd", "run_10.mcap"]);
    }
}
