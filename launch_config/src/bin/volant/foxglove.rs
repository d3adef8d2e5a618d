//! `volant foxglove`, and where `volant up --foxglove` serves.

use crate::{say, signals};
use anyhow::Context;
use launch_config::live::foxglove::{Foxglove, serve_at};
use node_kit::environment::{DiscoveryRange, Network};
use std::{net::Ipv4Addr, sync::atomic::Ordering, time::Duration};

#[derive(clap::Args)]
pub struct Arguments {
    /// Where it serves: ADDRESS, PORT or ADDRESS:PORT. Without it port 8765 of every address of this computer, or of the
    /// loopback alone where ROS 2's discovery is limited to this computer
    address: Option<String>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let stop = signals::stop_flag()?;
    let server = start(arguments.address.as_deref())?;
    while !stop.load(Ordering::Acquire) {
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(server);
    Ok(())
}

/// Starts a server and says where.
pub fn start(address: Option<&str>) -> anyhow::Result<Foxglove> {
    let network = Network::from_environment()?;
    let host = match network.range {
        DiscoveryRange::Localhost => Ipv4Addr::LOCALHOST,
        DiscoveryRange::Subnet => Ipv4Addr::UNSPECIFIED,
    };
    let address = serve_at(address.unwrap_or_default(), host.into()).with_context(|| {
        let given = address.unwrap_or_default();
        format!(
            "`{given}` is no address to serve at: give ADDRESS, PORT or ADDRESS:PORT, such as 127.0.0.1:8765"
        )
    })?;
    let server = Foxglove::start(address)?;
    say::line(&format!("volant: Foxglove can be connected to ws://{}", server.address()));
    Ok(server)
}
