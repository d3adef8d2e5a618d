//! Files of command line tools: text files of a limited size are read, and outputs are written so
//! that no existing file is lost.
//!
//! `--params-file /dev/zero` is an error and does not exhaust the memory. An [`OutputFile`] is
//! written under a temporary name beside its target and renamed when it is complete.

use std::{
    ffi::OsString,
    fs::{self, File, Metadata},
    io::{self, ErrorKind, Read, Seek, SeekFrom, Write},
    os::unix::fs::{FileTypeExt, MetadataExt},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};
use thiserror::Error;

/// Largest file that is read, bytes.
pub const LARGEST_TEXT: u64 = 1 << 20;

/// Reads a text file.
///
/// # Errors
/// The system's error, with the remedy where there is no such file; [`ErrorKind::FileTooLarge`]
/// beyond [`LARGEST_TEXT`]; [`ErrorKind::InvalidData`] if the text is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    let file = File::open(path).map_err(|error| match error.kind() {
        kind @ ErrorKind::NotFound => {
            io::Error::new(kind, "there is no such file; correct the path, or create the file")
        }
        _ => error,
    })?;
    file.take(LARGEST_TEXT + 1).read_to_string(&mut text)?;
    if text.len() as u64 > LARGEST_TEXT {
        let mebibytes = LARGEST_TEXT >> 20;
        return Err(io::Error::new(
            ErrorKind::FileTooLarge,
            format!("it is larger than {mebibytes} MiB, which no file of this kind is"),
        ));
    }
    Ok(text)
}

/// Why an output is not written. What was there before is unchanged.
#[derive(Debug, Error)]
pub enum FileError {
    /// A file with this name exists.
    #[error("{}: exists already; give another name, or --overwrite to replace it", .0.display())]
    Exists(PathBuf),
    /// A folder with this name exists; no option replaces it.
    #[error("{}: exists already and is a folder, which is never replaced; give another name",
            .0.display())]
    Folder(PathBuf),
    /// The output is one of the command's inputs, by whatever name.
    #[error("{}: the output is the input{}, which is never replaced; give it another name",
            path.display(),
            if input == path { String::new() } else { format!(" {}", input.display()) })]
    Input {
        /// The output.
        path: PathBuf,
        /// The input as given, or the member of an input folder.
        input: PathBuf,
    },
    /// Two outputs of the command are one file, by whatever name.
    #[error("{}: two outputs have this name; give each its own", .0.display())]
    Twice(PathBuf),
    /// An operation of the operating system failed.
    #[error("{}: cannot be written: {error}; check its folder, the permissions and the space on \
             the disk", path.display())]
    Io {
        /// The output.
        path: PathBuf,
        /// The system's error. The message has it, so it is no `source`: `{:#}` would repeat it.
        error: io::Error,
    },
}

impl FileError {
    fn io(path: &Path, error: io::Error) -> Self {
        Self::Io { path: path.to_owned(), error }
    }

    /// The error of creating what must not exist.
    fn of(path: &Path, error: io::Error) -> Self {
        match error.kind() {
            ErrorKind::AlreadyExists => Self::Exists(path.to_owned()),
            _ => Self::io(path, error),
        }
    }
}

/// Checks whether an output may be written before the work for it starts.
///
/// `inputs` are files and folders that the command reads; the output is none of them, nor a file in
/// one of the folders, by any name (links included).
///
/// # Errors
/// [`FileError::Input`]; [`FileError::Folder`]; [`FileError::Exists`] without `overwrite`.
pub fn check_output(path: &Path, overwrite: bool, inputs: &[&Path]) -> Result<(), FileError> {
    let Ok(link) = fs::symlink_metadata(path) else { return Ok(()) };
    let there = fs::metadata(path).unwrap_or(link);
    if is_special(&there) {
        return Ok(());
    }
    let same = |p: &Path| fs::metadata(p).is_ok_and(|m| identity(&m) == identity(&there));
    for input in inputs {
        let members = fs::read_dir(input).into_iter().flatten().flatten().map(|e| e.path());
        if let Some(input) = std::iter::once(input.to_path_buf()).chain(members).find(|p| same(p)) {
            return Err(FileError::Input { path: path.to_owned(), input });
        }
    }
    match (there.is_dir(), overwrite) {
        (true, _) => Err(FileError::Folder(path.to_owned())),
        (false, false) => Err(FileError::Exists(path.to_owned())),
        (false, true) => Ok(()),
    }
}

/// Checks all files that a command writes before the work for them starts, as [`check_output`]
/// does, and that their folders exist.
///
/// # Errors
/// As [`check_output`]; [`FileError::Twice`]; [`FileError::Io`] for a folder that does not exist.
pub fn check_outputs(
    outputs: &[&Path],
    overwrite: bool,
    inputs: &[&Path],
) -> Result<(), FileError> {
    let mut places = vec![];
    for &path in outputs {
        check_output(path, overwrite, inputs)?;
        if fs::metadata(path).is_ok_and(|there| is_special(&there)) {
            continue;
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = fs::canonicalize(folder.unwrap_or(Path::new(".")))
            .map_err(|e| FileError::io(path, e))?;
        if !folder.is_dir() {
            return Err(FileError::io(path, ErrorKind::NotADirectory.into()));
        }
        let new = folder.join(path.file_name().unwrap_or_default());
        let place = fs::canonicalize(path).unwrap_or(new);
        if places.contains(&place) {
            return Err(FileError::Twice(path.to_owned()));
        }
        places.push(place);
    }
    Ok(())
}

/// Writes a whole file as [`OutputFile`] does.
///
/// # Errors
/// As [`OutputFile::create`] and [`OutputFile::commit`].
pub fn write(path: &Path, bytes: &[u8], overwrite: bool) -> Result<(), FileError> {
    let mut output = OutputFile::create(path, overwrite)?;
    output.write_all(bytes).map_err(|e| FileError::io(path, e))?;
    output.commit()
}

/// File that is written under a temporary name, `NAME.PID.partial`, in its target's folder and
/// renamed by [`OutputFile::commit`]. Dropped without it, the temporary file is removed. A device
/// or pipe is written directly.
#[derive(Debug)]
pub struct OutputFile {
    file: File,
    /// `None` where the target is written directly.
    pending: Option<Pending>,
    target: PathBuf,
}

impl OutputFile {
    /// Creates the temporary file.
    ///
    /// # Errors
    /// As [`check_output`] without inputs; or the folder is not writable.
    pub fn create(path: &Path, overwrite: bool) -> Result<Self, FileError> {
        check_output(path, overwrite, &[])?;
        let io = |e| FileError::io(path, e);
        let former = fs::metadata(path).ok();
        if former.as_ref().is_some_and(is_special) {
            let file = File::options().write(true).open(path).map_err(io)?;
            return Ok(Self { file, pending: None, target: path.to_owned() });
        }
        let pending = Pending::new(path, overwrite)?;
        let file = File::create_new(&pending.temporary).map_err(io)?;
        if let Some(former) = former {
            file.set_permissions(former.permissions()).map_err(io)?;
        }
        Ok(Self { file, pending: Some(pending), target: path.to_owned() })
    }

    /// Creates a file that bears its own name from the start: of a recording, which is readable
    /// when its process is killed, or in a folder that is renamed as a whole.
    ///
    /// # Errors
    /// [`FileError::Exists`]; or the folder is not writable.
    pub fn in_place(path: &Path) -> Result<Self, FileError> {
        let file = File::create_new(path).map_err(|e| FileError::of(path, e))?;
        Ok(Self { file, pending: None, target: path.to_owned() })
    }

    /// Gives the complete file its name.
    ///
    /// # Errors
    /// The system's error, such as a full disk; or a file has appeared under that name meanwhile.
    pub fn commit(self) -> Result<(), FileError> {
        let Some(pending) = self.pending else { return Ok(()) };
        self.file.sync_data().map_err(|e| FileError::io(&self.target, e))?;
        pending.commit()
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for OutputFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Temporary name of a file or folder until it is complete; dropped before, what bears it is
/// removed.
#[derive(Debug)]
pub struct Pending {
    /// The temporary name.
    pub temporary: PathBuf,
    target: PathBuf,
    overwrite: bool,
}

impl Pending {
    /// Chooses the temporary name of an output; nothing is created yet.
    ///
    /// # Errors
    /// The path ends in no name; or [`discard_all`] was called.
    pub fn new(path: &Path, overwrite: bool) -> Result<Self, FileError> {
        // A link stays, and the file that it names is replaced, or made.
        let named = || fs::read_link(path).map(|to| path.with_file_name(to));
        let target = fs::canonicalize(path).or_else(|_| named());
        let target = target.unwrap_or_else(|_| path.to_owned());
        let name = target.file_name().ok_or_else(|| {
            FileError::io(path, io::Error::new(ErrorKind::InvalidInput, "it is no file name"))
        })?;
        let named = |end: &str| {
            let mut temporary = OsString::from(name);
            temporary.push(format!(".{}{end}.partial", std::process::id()));
            target.with_file_name(temporary)
        };
        let mut temporary = named("");
        let mut open = open();
        if open.discarded || open.paths.iter().any(|(t, _)| *t == temporary) {
            let reason = if open.discarded { "interrupted" } else { "it is written already" };
            return Err(FileError::io(path, io::Error::other(reason)));
        }
        // Left by a process of the same number that was killed: in a container it is always one.
        for k in 1.. {
            if fs::symlink_metadata(&temporary).is_err() {
                break;
            }
            temporary = named(&format!("-{k}"));
        }
        open.paths.push((temporary.clone(), path.to_owned()));
        Ok(Self { temporary, target, overwrite })
    }

    /// Gives the complete file or folder its name.
    ///
    /// # Errors
    /// As [`OutputFile::commit`].
    pub fn commit(self) -> Result<(), FileError> {
        // Held until the name is given: an interruption comes before or after, not between.
        let mut open = open();
        let (from, to) = (&self.temporary, &self.target);
        if open.discarded {
            return Err(FileError::io(to, ErrorKind::Interrupted.into()));
        }
        self.rename().map_err(|e| FileError::of(to, e))?;
        open.paths.retain(|(temporary, _)| temporary != from);
        Ok(())
    }

    fn rename(&self) -> io::Result<()> {
        let (from, to) = (&self.temporary, &self.target);
        if self.overwrite || from.is_dir() {
            // A folder replaces at most an empty one.
            return fs::rename(from, to);
        }
        // A second name fails where the file exists, which a rename does not.
        match fs::hard_link(from, to) {
            Ok(()) => fs::remove_file(from),
            Err(e) if e.kind() == ErrorKind::AlreadyExists => Err(e),
            // A file system without hard links.
            Err(_) if fs::symlink_metadata(to).is_ok() => Err(ErrorKind::AlreadyExists.into()),
            Err(_) => fs::rename(from, to),
        }
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        let mut open = open();
        if let Some(index) = open.paths.iter().position(|(t, _)| *t == self.temporary) {
            remove(&open.paths.swap_remove(index).0);
        }
    }
}

/// Outputs of this process that are not complete: temporary name, and name as given.
struct Open {
    paths: Vec<(PathBuf, PathBuf)>,
    discarded: bool,
}

static OPEN: Mutex<Open> = Mutex::new(Open { paths: vec![], discarded: false });

fn open() -> MutexGuard<'static, Open> {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes all incomplete outputs of an interrupted process and returns their targets' names; none
/// is completed or begun from now on.
pub fn discard_all() -> Vec<PathBuf> {
    let mut open = open();
    open.discarded = true;
    open.paths
        .drain(..)
        .map(|(temporary, path)| {
            remove(&temporary);
            path
        })
        .collect()
}

/// Removes what bears a temporary name; nobody can be informed where that fails.
fn remove(temporary: &Path) {
    let _ =
        if temporary.is_dir() { fs::remove_dir_all(temporary) } else { fs::remove_file(temporary) };
}

fn is_special(there: &Metadata) -> bool {
    let kind = there.file_type();
    kind.is_char_device() || kind.is_block_device() || kind.is_fifo() || kind.is_socket()
}

fn identity(file: &Metadata) -> (u64, u64) {
    (file.dev(), file.ino())
}

#[cfg(test)]
mod tests;
