//! The fuzz targets of all parsers of external bytes.

#[path = "../exercise/mod.rs"]
pub mod exercise;

use exercise::{TARGETS, Target};
use std::{env, fs, io, path::Path, process};

fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|t| t.name == name).expect("a target of that name")
}

/// One input through the parser of that name.
pub fn run(name: &str, data: &[u8]) {
    (target(name).run)(data);
}

/// Where `VOLANT_FUZZ_SEEDS` names a folder: writes the right inputs that fuzzing starts from, and
/// the format's words as libFuzzer's dictionary, and ends.
pub fn write_seeds(name: &str) {
    let Some(folder) = env::var_os("VOLANT_FUZZ_SEEDS") else { return };
    match write(target(name), Path::new(&folder)) {
        Ok(()) => process::exit(0),
        Err(error) => {
            eprintln!("{}: {error}", Path::new(&folder).display());
            process::exit(1);
        }
    }
}

fn write(target: &Target, folder: &Path) -> io::Result<()> {
    let into = folder.join(target.name);
    fs::create_dir_all(&into)?;
    for (k, seed) in (target.seeds)().iter().enumerate() {
        fs::write(into.join(format!("seed-{k}")), seed)?;
    }
    let words = target.words.iter().map(|word| {
        let word: String = word.iter().map(|b| format!("\\x{b:02X}")).collect();
        format!("\"{word}\"\n")
    });
    fs::write(folder.join(format!("{}.dict", target.name)), words.collect::<String>())
}

/// Defines the fuzz target of a name.
#[macro_export]
macro_rules! target {
    ($name:literal) => {
        libfuzzer_sys::fuzz_target!(
            init: volant_fuzz::write_seeds($name),
            |data: &[u8]| volant_fuzz::run($name, data)
        );
    };
}
