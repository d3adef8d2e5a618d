//! Where a simulated rig lives: on which computers, in which DDS domain.

use node_kit::{
    environment::Network,
    node::{NodeError, Process},
};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::{fs::File, io, os::fd::AsFd};

/// One of the rig's two computers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Host {
    /// With camera and encoders.
    Climber,
    /// With the IMU.
    Platform,
}

impl Host {
    /// Computer of a node: those of the climber's hardware on the climber, the others on the
    /// platform.
    pub fn of(node: &str) -> Self {
        if matches!(node, "marker_tracker" | "climber_driver") {
            Self::Climber
        } else {
            Self::Platform
        }
    }
}

/// Network namespaces of the two computers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Namespaces {
    pub climber: String,
    pub platform: String,
}

/// How a computer's clock is off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockError {
    /// Time ahead at the start, s.
    pub offset: f64,
    /// Rate error, 1e-6.
    pub ppm: f64,
}

#[derive(Clone, Debug, Default)]
pub struct Site {
    pub network: Network,
    /// Its two computers; `None`: this one.
    pub hosts: Option<Namespaces>,
    /// How the climber's clock is off: that of camera and encoders.
    pub climber_clock: ClockError,
    /// The nodes' clock, and that of camera and encoders, can be set ([`super::Run::set_clock`]).
    pub settable_clock: bool,
    /// The scenario repeats, and published messages are not kept.
    pub endless: bool,
}

impl Site {
    pub fn here(network: &Network) -> Self {
        Self { network: network.clone(), ..Self::default() }
    }

    pub fn namespace_of(&self, host: Host) -> Option<&str> {
        self.hosts.as_ref().map(|n| match host {
            Host::Climber => n.climber.as_str(),
            Host::Platform => n.platform.as_str(),
        })
    }

    /// Joins the DDS domain on a computer. A socket belongs to the network namespace of the thread
    /// that creates it, so a separate thread joins.
    pub(super) fn join(&self, host: Host) -> Result<Process, NodeError> {
        let network = self.network.clone();
        let Some(name) = self.namespace_of(host) else { return Process::new(network) };
        let failed =
            |error| NodeError::System { what: format!("the network namespace {name}"), error };
        std::thread::scope(|scope| {
            let there = scope.spawn(|| {
                enter(name).map_err(failed)?;
                Process::new(network)
            });
            there
                .join()
                .unwrap_or_else(|_| Err(NodeError::shell("joining the DDS domain panicked")))
        })
    }
}

/// Moves the calling thread into a network namespace that `ip netns` made.
fn enter(name: &str) -> io::Result<()> {
    let file = File::open(format!("/run/netns/{name}"))?;
    Ok(move_into_link_name_space(file.as_fd(), Some(LinkNameSpaceType::Network))?)
}
