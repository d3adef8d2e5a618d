//! The rig's two computers on one machine: two network namespaces and an impaired link between
//! them.
//!
//! [`Hosts`] creates and removes them; [`impairment`] decides what happens to a frame, [`link`]
//! carries it; [`trial`] runs the live rig over it, [`sites`] rigs and an operator with bridges.

pub mod impairment;
pub mod link;
pub mod sites;
pub mod trial;

pub use impairment::Impairment;
pub use link::Link;

use crate::live::Namespaces;
use anyhow::{Error, Result, anyhow};
use std::{fmt::Display, process::Command};

/// Two computers with a link between them. All of it is gone when this drops.
pub struct Hosts {
    made: Made,
    pub link: Link,
}

impl Hosts {
    /// Creates them. The process id is part of their names, so that several can exist at once.
    pub fn new(seed: u64) -> Result<Self> {
        remove_left_over();
        let id = std::process::id();
        let made = Made(Namespaces {
            climber: format!("volant-c-{id}"),
            platform: format!("volant-p-{id}"),
        });
        let places = [&made.0.climber, &made.0.platform];
        let names = [format!("vc{id}"), format!("vp{id}")];
        for name in places {
            ip(&["netns", "add", name])?;
        }
        let link = Link::new([&names[0], &names[1]], seed)
            .map_err(|e| not_permitted("a tap device", e))?;
        for (i, (place, end)) in places.into_iter().zip(&names).enumerate() {
            ip(&["link", "set", end, "netns", place])?;
            ip(&["-n", place, "address", "add", &format!("10.77.0.{}/24", i + 1), "dev", end])?;
            ip(&["-n", place, "link", "set", "lo", "up"])?;
            ip(&["-n", place, "link", "set", end, "up"])?;
            ip(&["-n", place, "route", "add", "224.0.0.0/4", "dev", end])?;
        }
        Ok(Self { made, link })
    }

    pub fn namespaces(&self) -> &Namespaces {
        &self.made.0
    }
}

/// Takes away what a process that was killed has left.
fn remove_left_over() {
    let Ok(folder) = std::fs::read_dir("/run/netns") else { return };
    for name in
        folder.filter_map(Result::ok).filter_map(|entry| entry.file_name().into_string().ok())
    {
        let id = ["volant-c-", "volant-p-"].iter().find_map(|kind| name.strip_prefix(kind));
        if id.is_some_and(|id| !std::path::Path::new("/proc").join(id).exists()) {
            let _ = ip(&["netns", "delete", &name]);
        }
    }
}

/// The namespaces, removed when this drops.
struct Made(Namespaces);

impl Drop for Made {
    fn drop(&mut self) {
        for name in [&self.0.climber, &self.0.platform] {
            let _ = ip(&["netns", "delete", name]);
        }
    }
}

fn ip(arguments: &[&str]) -> Result<()> {
    let line = format!("`ip {}`", arguments.join(" "));
    let output =
        Command::new("ip").args(arguments).output().map_err(|e| not_permitted(&line, e))?;
    if output.status.success() {
        return Ok(());
    }
    Err(not_permitted(&line, String::from_utf8_lossy(&output.stderr).trim()))
}

fn not_permitted(what: &str, reason: impl Display) -> Error {
    anyhow!(
        "two hosts need network namespaces and a tap device, that is root (or CAP_NET_ADMIN and \
         CAP_SYS_ADMIN), iproute2 and /dev/net/tun: {what}: {reason}"
    )
}
