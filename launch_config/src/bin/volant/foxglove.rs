//! `volant foxglove`, and where `volant up --foxglove` serves.

use crate::{say, signals};
use anyhow::Context;
use launch_config::live::foxglove::{Foxglove, PORT};
use node_kit::environment::{DiscoveryRange, Network};
use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::atomic::Ordering,
    time::Duration,
};

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
    let address = parse(address.unwrap_or_default(), host.into())
        .with_context(|| format!("`{}` is no address to serve at", address.unwrap_or_default()))?;
    let server = Foxglove::start(address)?;
    say::line(&format!("volant: Foxglove can be connected to ws://{}", server.address()));
    Ok(server)
}

fn parse(text: &str, host: IpAddr) -> anyhow::Result<SocketAddr> {
    if text.is_empty() {
        return Ok(SocketAddr::new(host, PORT));
    }
    if let Ok(port) = text.parse::<u16>() {
        return Ok(SocketAddr::new(host, port));
    }
    if let Ok(address) = text.parse::<IpAddr>() {
        return Ok(SocketAddr::new(address, PORT));
    }
    text.parse().context("give ADDRESS, PORT or ADDRESS:PORT, such as 127.0.0.1:8765")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_a_port_or_both() {
        let host = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let show = |text| parse(text, host).map(|a| a.to_string()).ok();
        assert_eq!(show("").as_deref(), Some("127.0.0.1:8765"));
        assert_eq!(show("9000").as_deref(), Some("127.0.0.1:9000"));
        assert_eq!(show("10.0.0.1").as_deref(), Some("10.0.0.1:8765"));
        assert_eq!(show("10.0.0.1:1").as_deref(), Some("10.0.0.1:1"));
        assert_eq!(show("::1").as_deref(), Some("[::1]:8765"));
        assert_eq!(show("70000"), None);
        assert_eq!(show("here"), None);
    }
}
