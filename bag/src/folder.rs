//! Files of a bag: a lone file, or those of a rosbag2 folder.

use crate::{BagError, file_reader::io_error, metadata::Folder, summary::has_footer};
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

/// Returns the files of a bag that may be damaged, and a sentence on each file of its folder that
/// is left out, or that its `metadata.yaml` does not name.
///
/// Of a folder these are the files that its `metadata.yaml` names, which may be missing, and
/// further ones of the same recording (`NAME_12.mcap`): a recorder that died has left the list
/// incomplete. Without a list of which a file is there, these are all files with such a name, and
/// where none has one, all MCAP files.
///
/// # Errors
/// There is no such path; a folder is unreadable, has no such file, or is of another storage or
/// compression.
pub fn files_to_recover(path: &Path) -> Result<(Vec<PathBuf>, Vec<String>), BagError> {
    if !fs::metadata(path).map_err(|source| io_error(path, source))?.is_dir() {
        return Ok((vec![path.to_owned()], vec![]));
    }
    let text = metadata_text(&path.join("metadata.yaml")).ok();
    let folder = text.and_then(|text| Folder::parse(&text).ok());
    // Text that was cut off may lack the storage, which then says nothing.
    let folder = folder.filter(|folder| !folder.storage_identifier.is_empty());
    if let Some(what) = folder.as_ref().and_then(not_ours) {
        return Err(BagError::foreign(path, what));
    }
    let names = folder.and_then(|folder| own_files(folder).ok()).unwrap_or_default();
    let named = names.iter().map(|name| path.join(name)).collect();
    let error = |source| io_error(path, source);
    let mut found = vec![];
    for entry in fs::read_dir(path).map_err(error)? {
        let file = entry.map_err(error)?.path();
        if is_mcap(&file) {
            found.push(file);
        }
    }
    found.sort_by_cached_key(|file| (split(file).map_or(0, |(_, number)| number), file.clone()));
    let (files, notes) = files_of_recording(found, named);
    if files.is_empty() {
        let reason = "the folder holds no .mcap file; give another one";
        return Err(BagError::unusable(path, reason));
    }
    Ok((files, notes))
}

/// Returns the files of the recording among those that a folder holds, then those that only its
/// list names, and a sentence on each file that is left out or not in the list.
fn files_of_recording(found: Vec<PathBuf>, named: Vec<PathBuf>) -> (Vec<PathBuf>, Vec<String>) {
    let listed: BTreeSet<PathBuf> = named.iter().map(|file| uncompressed(file)).collect();
    let is_listed = |file: &PathBuf| listed.contains(&uncompressed(file));
    let has_list = found.iter().any(is_listed) || named.iter().any(|file| file.exists());
    let splits = named.iter().filter_map(|file| split(file));
    let recordings: BTreeSet<String> = splits.map(|(recording, _)| recording).collect();
    let has_splits = found.iter().any(|file| split(file).is_some());
    let present: BTreeSet<PathBuf> = found.iter().cloned().collect();
    let replaced = found.iter().filter(|file| replaces_cut_off_file(file));
    let replaced: BTreeSet<PathBuf> = replaced.map(|file| uncompressed(file)).collect();
    let (mut files, mut notes) = (vec![], vec![]);
    for file in found {
        let (plain, shown) = (uncompressed(&file), file.display());
        let belongs = match split(&file) {
            _ if listed.contains(&plain) => true,
            Some((recording, _)) => !has_list || recordings.contains(&recording),
            // Such as the bag that an earlier recovery wrote into the folder.
            None => !has_list && !has_splits,
        };
        // A recorder that died while it compressed a file has left both.
        if plain == file && replaced.contains(&plain) {
            notes.push(format!(
                "{shown}: left out, since it is cut off and compressed beside itself; to read it \
                 too, give it beside the folder"
            ));
        } else if plain != file && present.contains(&plain) && !replaced.contains(&plain) {
            notes.push(format!(
                "{shown}: left out, since it is {} compressed; to read it too, give it beside the \
                 folder",
                plain.display()
            ));
        } else if belongs {
            if has_list && !listed.contains(&plain) {
                notes.push(format!(
                    "{shown}: not in metadata.yaml; read, since its name is that of a further file \
                     of this recording"
                ));
            }
            files.push(file);
        } else {
            notes.push(format!(
                "{shown}: left out, since its name is not that of a file of this recording; to \
                 read it too, give it beside the folder"
            ));
        }
    }
    let mut known: BTreeSet<PathBuf> = files.iter().map(|file| uncompressed(file)).collect();
    files.extend(named.into_iter().filter(|file| known.insert(uncompressed(file))));
    (files, notes)
}

/// Whether a bag of this name is a lone file (`.mcap`, in capitals too) and not a folder.
pub fn is_mcap_file(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap"))
}

/// Endings of the names of MCAP files.
const ENDINGS: [&str; 3] = [".mcap", ".mcap.zstd", ".mcap.zst"];

fn is_mcap(file: &Path) -> bool {
    let name = file.to_string_lossy();
    is_mcap_file(file) || ENDINGS.into_iter().any(|ending| name.ends_with(ending))
}

/// Path of a file before its compression: `run_3.mcap.zstd` → `run_3.mcap`.
fn uncompressed(file: &Path) -> PathBuf {
    let is_compressed = file.extension().is_some_and(|ending| ending == "zstd" || ending == "zst");
    if is_compressed { file.with_extension("") } else { file.to_owned() }
}

/// Whether a compressed file is to be read instead of the uncompressed one beside it, which was cut
/// off, as by an interrupted decompression.
fn replaces_cut_off_file(file: &Path) -> bool {
    let plain = uncompressed(file);
    plain != file
        && plain.exists()
        && !has_footer(&plain)
        && fs::metadata(file).is_ok_and(|compressed| compressed.len() > 0)
}

/// Name of a split recording, and the number of one of its files: `run_12.mcap` → (`run`, 12).
fn split(file: &Path) -> Option<(String, u64)> {
    let name = file.file_name()?.to_string_lossy().into_owned();
    let stem = ENDINGS.into_iter().find_map(|ending| name.strip_suffix(ending))?;
    let (recording, number) = stem.rsplit_once('_')?;
    Some((recording.to_owned(), number.parse().ok()?))
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
            return Err(without_metadata(path));
        }
        Err(error) => return Err(BagError::Io { path: yaml.clone(), error }),
    };
    let folder = Folder::parse(&text).map_err(&broken)?;
    if let Some(what) = not_ours(&folder) {
        return Err(BagError::foreign(path, what));
    }
    let names = own_files(folder).map_err(&broken)?;
    let files: Vec<PathBuf> = names.iter().map(|name| path.join(name)).collect();
    if let Some(missing) = files.iter().find(|f| !f.exists()) {
        return Err(broken(format!("names {}, which is not there", missing.display())));
    }
    Ok(files)
}

/// The error of a folder without `metadata.yaml`.
fn without_metadata(path: &Path) -> BagError {
    let mut entries = fs::read_dir(path).into_iter().flatten().flatten();
    let remedy = if entries.any(|entry| is_mcap(&entry.path())) {
        "here is only the latter, as after a recorder was killed; `volant bag recover` writes a \
         complete bag from it"
    } else {
        "here is neither; give the folder of a recording, or an .mcap file"
    };
    BagError::unusable(
        path,
        format!(
            "this folder is not a rosbag2 bag, which holds metadata.yaml and the .mcap files that \
             it names; {remedy}"
        ),
    )
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

    /// Names of the files to recover, and of those with a sentence of their own.
    fn recovered(folder: &Path) -> [Vec<String>; 2] {
        let (files, notes) = files_to_recover(folder).unwrap();
        let name = |file: &Path| file.strip_prefix(folder).unwrap().display().to_string();
        let noted = notes.iter().map(|note| name(Path::new(note.split(": ").next().unwrap())));
        [files.iter().map(|file| name(file)).collect(), noted.collect()]
    }

    fn folder_with(names: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for name in names {
            fs::write(dir.path().join(name), "").unwrap();
        }
        dir
    }

    #[test]
    fn every_file_of_a_recording_is_recovered_whatever_its_metadata_says() {
        let dir = folder_with(&[]);
        let error = files_to_recover(dir.path()).unwrap_err().to_string();
        assert!(error.contains("holds no .mcap file"), "{error}");
        let dir = folder_with(&["run_10.mcap", "run_9.mcap.zstd", "notes.txt"]);
        let metadata = |text: &str| fs::write(dir.path().join("metadata.yaml"), text).unwrap();
        let [files, notes] = recovered(dir.path());
        assert_eq!(files, ["run_9.mcap.zstd", "run_10.mcap"]);
        assert!(notes.is_empty(), "{notes:?}");
        metadata(&format!("{HEAD}    - ./run_10.mcap\n    - gone.mcap\n"));
        let [files, notes] = recovered(dir.path());
        assert_eq!(files, ["run_9.mcap.zstd", "run_10.mcap", "gone.mcap"]);
        assert_eq!(notes, ["run_9.mcap.zstd"]);
        // A list that was cut off, and one of files that have other names now.
        for text in ["{", "rosbag2_bagfile_information:\n  version: 9\n"] {
            metadata(text);
            assert_eq!(recovered(dir.path())[0], ["run_9.mcap.zstd", "run_10.mcap"], "{text}");
        }
        metadata(&format!("{HEAD}    - old_0.mcap\n"));
        let files = ["run_9.mcap.zstd", "run_10.mcap", "old_0.mcap"];
        assert_eq!(recovered(dir.path())[0], files);
        metadata(&format!("{HEAD}    - run_10.mcap\n    - run.0\n    - run.1\n"));
        let files = ["run_9.mcap.zstd", "run_10.mcap", "run.0", "run.1"];
        assert_eq!(recovered(dir.path())[0], files);
        let dir = folder_with(&["b.mcap", "a.mcap"]);
        assert_eq!(recovered(dir.path())[0], ["a.mcap", "b.mcap"]);
    }

    #[test]
    fn no_message_of_a_folder_is_recovered_twice() {
        let names =
            ["run_2.mcap", "run_3.mcap", "run_3.mcap.zstd", "run_4.mcap.zstd", "fixed.mcap"];
        let dir = folder_with(&names);
        let files = ["run_2.mcap", "run_3.mcap", "run_4.mcap.zstd"];
        let [found, left_out] = recovered(dir.path());
        assert_eq!(found, files);
        assert_eq!(left_out, ["fixed.mcap", "run_3.mcap.zstd"]);
        let text = format!("{HEAD}    - run_2.mcap\n    - run_3.mcap.zstd\n    - run_4.mcap\n");
        fs::write(dir.path().join("metadata.yaml"), text).unwrap();
        let [found, left_out] = recovered(dir.path());
        assert_eq!(found, files);
        assert_eq!(left_out, ["fixed.mcap", "run_3.mcap.zstd"]);
        // The uncompressed file is read unless it was cut off.
        fs::write(dir.path().join("run_3.mcap.zstd"), "compressed").unwrap();
        let [found, left_out] = recovered(dir.path());
        assert_eq!(found, ["run_2.mcap", "run_3.mcap.zstd", "run_4.mcap.zstd"]);
        assert_eq!(left_out, ["fixed.mcap", "run_3.mcap"]);
        let mut end = vec![2];
        end.extend_from_slice(&20_u64.to_le_bytes());
        end.extend_from_slice(&[0; 20]);
        end.extend_from_slice(mcap::MAGIC);
        fs::write(dir.path().join("run_3.mcap"), end).unwrap();
        assert_eq!(recovered(dir.path())[0], files);
    }

    #[test]
    fn a_folder_with_compressed_messages_is_foreign_although_it_has_an_mcap_file() {
        let dir = folder_with(&["run_0.mcap"]);
        let compression = "  compression_format: zstd\n  compression_mode: MESSAGE\n";
        let text = format!("{HEAD}    - run_0.mcap\n{compression}");
        fs::write(dir.path().join("metadata.yaml"), text).unwrap();
        let error = files_to_recover(dir.path()).unwrap_err().to_string();
        assert!(error.contains("one by one") && error.contains("ros2 bag convert"), "{error}");
    }
}
