//! Generator of Rust types from `.msg` and `.srv` files.
//!
//! [`parse`] reads the text, [`describe`] derives definition text and RIHS01 hash, [`emit`] writes
//! the source. Used by `build.rs`.

pub mod describe;
pub mod emit;
pub mod parse;

use parse::{Interface, Name};
use std::{collections::BTreeMap, error::Error, fs, path::Path};

/// This package: its `.msg` files are in `msg/`, its types in `crate::msg`.
pub const OWN_PACKAGE: &str = "volant_msgs";

/// All interfaces.
#[derive(Debug, Default)]
pub struct Interfaces {
    /// Messages by full name, including the requests and responses of services.
    pub messages: BTreeMap<String, Interface>,
    /// Services: `pkg/srv/Name`.
    pub services: Vec<Name>,
}

/// Reads `root/msg` and `root/interfaces/<package>/{msg,srv}`.
///
/// # Errors
/// A folder or file cannot be read, or a file is not a valid interface.
pub fn read_interfaces(root: &Path) -> Result<Interfaces, Box<dyn Error>> {
    let mut set = Interfaces::default();
    read_folder(&mut set, OWN_PACKAGE, "msg", &root.join("msg"))?;
    let mut packages: Vec<_> = fs::read_dir(root.join("interfaces"))?.collect::<Result<_, _>>()?;
    packages.sort_by_key(fs::DirEntry::file_name);
    for package in packages {
        let name = package.file_name().to_string_lossy().into_owned();
        for kind in ["msg", "srv"] {
            let folder = package.path().join(kind);
            if folder.is_dir() {
                read_folder(&mut set, &name, kind, &folder)?;
            }
        }
    }
    Ok(set)
}

fn read_folder(
    set: &mut Interfaces,
    package: &str,
    kind: &str,
    folder: &Path,
) -> Result<(), Box<dyn Error>> {
    let mut files: Vec<_> = fs::read_dir(folder)?.collect::<Result<_, _>>()?;
    files.sort_by_key(fs::DirEntry::file_name);
    for file in files {
        let path = file.path();
        if path.extension().is_none_or(|e| e != kind) {
            continue;
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let text = fs::read_to_string(&path)?;
        set.add(Name::new(package, kind, &stem), &text)
            .map_err(|e| format!("{}: {e}", path.display()))?;
    }
    Ok(())
}

impl Interfaces {
    /// Parses and adds the text of one file; an error has line and reason.
    pub fn add(&mut self, name: Name, text: &str) -> Result<(), String> {
        if name.kind == "srv" {
            let mut lines = text.split_inclusive('\n');
            let request: String = lines.by_ref().take_while(|l| l.trim_end() != "---").collect();
            if !text.lines().any(|l| l.trim_end() == "---") {
                return Err("a service needs a line `---` between request and response".into());
            }
            let response: String = lines.collect();
            for (suffix, part) in [("_Request", request), ("_Response", response)] {
                let part_name = Name::new(&name.package, "srv", &format!("{}{suffix}", name.name));
                self.messages.insert(part_name.to_string(), Interface::parse(part_name, &part)?);
            }
            self.services.push(name);
        } else {
            self.messages.insert(name.to_string(), Interface::parse(name, text)?);
        }
        Ok(())
    }
}
