//! A settable clock for the nodes' processes: libfaketime, controlled by a file. The machine's own
//! clock is not changed.

use super::RunError;
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// The clock of a rig's nodes.
#[derive(Clone, Debug)]
pub struct SettableClock {
    library: PathBuf,
    file: PathBuf,
}

impl SettableClock {
    /// A clock that shows the time as it is, with its file in `folder`.
    ///
    /// # Errors
    /// libfaketime is not installed, or the file is not writable.
    pub fn new(folder: &Path) -> Result<Self, RunError> {
        let multiarch = format!("/usr/lib/{}-linux-gnu/faketime", std::env::consts::ARCH);
        let places = [
            multiarch.as_str(),
            "/usr/lib/faketime",
            "/usr/lib64/faketime",
            "/usr/local/lib/faketime",
        ];
        let library = places.iter().map(|place| Path::new(place).join("libfaketimeMT.so.1"));
        let library = library.into_iter().find(|path| path.is_file()).ok_or_else(|| {
            RunError::NotPossible {
                what: "a clock that can be set",
                reason: "libfaketime is not there; install it (Debian: apt install libfaketime)"
                    .to_owned(),
            }
        })?;
        let clock = Self { library, file: folder.join("clock") };
        clock.set(0.0)?;
        Ok(clock)
    }

    /// Sets it this many seconds ahead of the true time.
    ///
    /// # Errors
    /// The file is not writable.
    pub fn set(&self, ahead: f64) -> Result<(), RunError> {
        let io = |error: io::Error| RunError::Io { path: self.file.clone(), error };
        // Written in one piece: libfaketime reads it whenever a process reads the clock.
        let next = self.file.with_extension("next");
        fs::write(&next, format!("{ahead:+.6}\n")).map_err(io)?;
        fs::rename(&next, &self.file).map_err(io)
    }

    /// What a process needs in its environment to live by it.
    pub fn environment(&self) -> Vec<(String, String)> {
        [
            ("LD_PRELOAD", self.library.display().to_string()),
            ("FAKETIME_TIMESTAMP_FILE", self.file.display().to_string()),
            ("FAKETIME_NO_CACHE", "1".to_owned()),
            // Nobody can set that one, and files keep the times that they have.
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1".to_owned()),
            ("NO_FAKE_STAT", "1".to_owned()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .to_vec()
    }
}
