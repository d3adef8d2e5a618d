//! Writes the initial inputs of fuzzing to the folder `VOLANT_FUZZ_SEEDS`, if it is set, and exits.

#[path = "mutate.rs"]
#[allow(dead_code)]
mod mutate;

use std::{env, fs, path::Path, process};

pub fn write(target: &str) {
    let Some(folder) = env::var_os("VOLANT_FUZZ_SEEDS") else { return };
    let into = Path::new(&folder).join(target);
    let written = fs::create_dir_all(&into).and_then(|()| {
        mutate::seeds()
            .iter()
            .enumerate()
            .try_for_each(|(k, seed)| fs::write(into.join(format!("seed-{k}")), seed))
    });
    if let Err(error) = &written {
        eprintln!("{}: {error}", into.display());
    }
    process::exit(i32::from(written.is_err()));
}
