//! From `.msg` and `.srv` text to Rust source: [`parse`] reads it, [`describe`] gives the definition text and the
//! RIHS01 hash that ROS 2 would give, [`emit`] writes the types. Used by `build.rs` and by its tests.

pub mod describe;
pub mod emit;
pub mod parse;

use parse::{Interface, Name};
use std::{collections::BTreeMap, error::Error, fmt, fs, path::Path};

/// The package whose `.msg` files lie in `msg/` and whose types are found at `crate::msg`.
pub const OWN_PACKAGE: &str = "volant_msgs";

/// Every message by its full name; a service is there as its request and its response.
#[derive(Debug, Default)]
pub struct Interfaces {
    /// Messages, the requests and responses of services included.
    pub messages: BTreeMap<Name, Interface>,
    /// Services: `pkg/srv/Name`.
    pub services: Vec<Name>,
}

/// What is wrong with a file, and in which line.
#[derive(Debug)]
pub struct GenerateError {
    /// The file or the interface.
    pub place: String,
    /// What is wrong.
    pub message: String,
}

impl fmt::Display for GenerateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

impl Error for GenerateError {}

/// Reads `root/msg` and `root/interfaces/<package>/{msg,srv}`.
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

fn read_folder(set: &mut Interfaces, package: &str, kind: &str, folder: &Path) -> Result<(), Box<dyn Error>> {
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
            .map_err(|e| GenerateError { place: path.display().to_string(), message: e })?;
    }
    Ok(())
}

impl Interfaces {
    /// Adds one file's text.
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
                let message = Interface::parse(part_name.clone(), &part)?;
                self.messages.insert(part_name, message);
            }
            self.services.push(name);
        } else {
            let message = Interface::parse(name.clone(), text)?;
            self.messages.insert(name, message);
        }
        Ok(())
    }

    /// The message of that name.
    pub fn get(&self, name: &Name) -> Result<&Interface, GenerateError> {
        self.messages.get(name).ok_or_else(|| GenerateError {
            place: name.to_string(),
            message: "is used by another interface, but there is no file for it".into(),
        })
    }
}
