//! Generates Rust types from the `.msg` and `.srv` files of this package: `msg/` (its own) and
//! `interfaces/` (standard ROS 2 packages).
//!
//! The output depends on these files only; nothing is downloaded.

#[path = "generator/mod.rs"]
mod generator;

use std::{env, error::Error, fs, path::Path};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=generator");
    println!("cargo::rerun-if-changed=interfaces");
    println!("cargo::rerun-if-changed=msg");
    let root = env::var("CARGO_MANIFEST_DIR")?;
    let set = generator::read_interfaces(Path::new(&root))?;
    let text = generator::emit::rust_source(&set)?;
    let out = env::var("OUT_DIR")?;
    fs::write(Path::new(&out).join("messages.rs"), text)?;
    Ok(())
}
