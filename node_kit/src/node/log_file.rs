//! The log file of a process, named and placed as rcl's: `ROS_LOG_DIR`, else `ROS_HOME/log`, else
//! `~/.ros/log`; `<program>_<process>_<milliseconds since 1970>.log`.

use super::clock::Clock;
use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

/// Returns the folder of log files; `get` reads an environment variable. `None` without a home.
fn folder(get: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    let get = |name| get(name).filter(|value: &String| !value.is_empty());
    let home = get("HOME").map(PathBuf::from);
    // rcl expands a leading `~`, which a shell does not in `A=x:~`.
    let expanded = |path: String| match (path.strip_prefix('~'), &home) {
        (Some(rest), Some(home)) => home.join(rest.trim_start_matches('/')),
        _ => PathBuf::from(path),
    };
    get("ROS_LOG_DIR")
        .map(expanded)
        .or_else(|| Some(expanded(get("ROS_HOME")?).join("log")))
        .or_else(|| Some(home.as_ref()?.join(".ros/log")))
}

/// Creates the log file of this process; `prefix` replaces the program's name
/// (`--log-file-name`). `None` where no folder is known.
///
/// # Errors
/// The path, and the system's error.
pub(crate) fn create(prefix: Option<&str>) -> Result<Option<File>, (PathBuf, io::Error)> {
    let Some(folder) = folder(|name| std::env::var(name).ok()) else { return Ok(None) };
    let program = std::env::current_exe().ok();
    let program = program.as_deref().and_then(Path::file_stem).map(|name| name.to_string_lossy());
    let prefix = prefix.or(program.as_deref()).unwrap_or("volant");
    let milliseconds = Clock::default().now().as_nanos() / 1_000_000;
    let path = folder.join(format!("{prefix}_{}_{milliseconds}.log", std::process::id()));
    fs::create_dir_all(&folder)
        .and_then(|()| File::options().append(true).create_new(true).open(&path))
        .map(Some)
        .map_err(|error| (path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_is_that_of_rcl() {
        let of = |variables: &[(&str, &str)]| {
            folder(|name| {
                variables.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned())
            })
        };
        let home = ("HOME", "/home/a");
        assert_eq!(of(&[home]), Some("/home/a/.ros/log".into()));
        assert_eq!(of(&[home, ("ROS_HOME", "/r")]), Some("/r/log".into()));
        assert_eq!(
            of(&[home, ("ROS_HOME", "/r"), ("ROS_LOG_DIR", "~/l")]),
            Some("/home/a/l".into())
        );
        assert_eq!(of(&[home, ("ROS_LOG_DIR", "")]), Some("/home/a/.ros/log".into()));
        assert_eq!(of(&[]), None);
    }
}
