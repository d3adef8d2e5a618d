//! A settable clock for the nodes' processes: libfaketime, controlled by a file. The machine's own
//! clock is not changed.

use anyhow::{Context, Result, anyhow};
use std::{
    fs,
    path::{Path, PathBuf},
};

#[derive(Clone, Debug)]
pub struct SettableClock {
    library: PathBuf,
    file: PathBuf,
}

impl SettableClock {
    /// A clock that shows the time as it is, with its file in `folder`.
    pub fn new(folder: &Path) -> Result<Self> {
        let multiarch = format!("/usr/lib/{}-linux-gnu/faketime", std::env::consts::ARCH);
        let places = [
            multiarch.as_str(),
            "/usr/lib/faketime",
            "/usr/lib64/faketime",
            "/usr/local/lib/faketime",
        ];
        let library = places.iter().map(|place| Path::new(place).join("libfaketimeMT.so.1"));
        let library = library.into_iter().find(|path| path.is_file()).context(
            "a clock that can be set: libfaketime is not there; install it (Debian: apt install \
             libfaketime)",
        )?;
        let clock = Self { library, file: folder.join("clock") };
        clock.set(0.0)?;
        Ok(clock)
    }

    /// Sets it this many seconds ahead of the true time.
    pub fn set(&self, ahead: f64) -> Result<()> {
        // Written in one piece: libfaketime reads it whenever a process reads the clock.
        let next = self.file.with_extension("next");
        fs::write(&next, format!("{ahead:+.6}\n"))
            .and_then(|()| fs::rename(&next, &self.file))
            .map_err(|error| anyhow!("{}: {error}", self.file.display()))
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
