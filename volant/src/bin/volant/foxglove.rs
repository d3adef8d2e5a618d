//! `volant foxglove`, and where `volant up --foxglove` serves.

use crate::terminal;
use node_kit::environment::{DiscoveryRange, Network};
use std::{net::Ipv4Addr, sync::atomic::Ordering, time::Duration};
use volant::{
    command_line::UsageError,
    live::foxglove::{Foxglove, serve_at},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Address to serve at: ADDRESS, PORT or ADDRESS:PORT [default: port 8765 of all addresses, or
    /// of the loopback where ROS 2's discovery is limited to this computer]
    address: Option<String>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let stop = node_kit::console::stop_flag()?;
    let server = start(arguments.address.as_deref())?;
    while !stop.load(Ordering::Acquire) {
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(server);
    Ok(())
}

/// Starts a server and prints its address.
pub fn start(address: Option<&str>) -> anyhow::Result<Foxglove> {
    let network = Network::from_environment()?;
    let host = match network.range {
        DiscoveryRange::Localhost => Ipv4Addr::LOCALHOST,
        DiscoveryRange::Subnet => Ipv4Addr::UNSPECIFIED,
    };
    let given = address.unwrap_or_default();
    let address = serve_at(given, host.into()).ok_or_else(|| {
        UsageError(format!(
            "`{given}` is not an address; give ADDRESS, PORT or ADDRESS:PORT, such as \
             127.0.0.1:8765"
        ))
    })?;
    let server = Foxglove::start(address)?;
    terminal::warn(format!("connect Foxglove to ws://{}", server.address()));
    Ok(server)
}
