//! The fuzz targets of all parsers of external bytes in one executable: `VOLANT_FUZZ_TARGET` names
//! the one that runs.
#![no_main]

#[path = "../exercise/mod.rs"]
mod exercise;

use exercise::{TARGETS, Target};
use std::{env, fs, io, path::Path, process, sync::LazyLock};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = env::var("VOLANT_FUZZ_TARGET").expect("VOLANT_FUZZ_TARGET names the target");
    TARGETS.iter().find(|t| t.name == name).expect("a target of that name")
});

libfuzzer_sys::fuzz_target!(init: write_seeds(), |data: &[u8]| (TARGET.run)(data));

/// Where `VOLANT_FUZZ_SEEDS` names a folder: writes the right inputs that fuzzing starts from, and
/// the format's words as libFuzzer's dictionary, and ends.
fn write_seeds() {
    let Some(folder) = env::var_os("VOLANT_FUZZ_SEEDS") else { return };
    match write(&TARGET, Path::new(&folder)) {
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
