//! The Zenoh bridge for ROS 2: Eclipse's plugin, with the arguments of its released executable that
//! the launch files use.
//!
//! Eclipse publishes the executable `zenoh-bridge-ros2dds` as an archive, a Debian package and an
//! image, but not on crates.io; the plugin, which does all the work, is there. This starts it, for
//! tests and for computers that reach crates.io only. Prefer the release.

use anyhow::{Context as _, Result, anyhow};
use clap::Parser;
use std::path::PathBuf;
use zenoh::{
    Config,
    config::WhatAmI,
    internal::{plugins::PluginsManager, runtime::RuntimeBuilder},
};
use zenoh_plugin_ros2dds::ROS2Plugin;

/// Connects the ROS 2 domain of this site with those of other sites.
#[derive(Parser)]
struct Arguments {
    /// Configuration, JSON5
    #[arg(short, long)]
    config: Option<PathBuf>,
    /// Namespace in front of every name of this site, as others see it
    #[arg(short, long)]
    namespace: Option<String>,
    /// DDS domain
    #[arg(short, long, env = "ROS_DOMAIN_ID")]
    domain: Option<u32>,
    /// Endpoint for the other sites, such as tcp/0.0.0.0:7447
    #[arg(short, long)]
    listen: Vec<String>,
    /// Endpoint of another site, such as tcp/operator.example:7447
    #[arg(short = 'e', long)]
    connect: Vec<String>,
}

impl Arguments {
    fn config(self) -> Result<Config> {
        let mut config = match &self.config {
            Some(path) => {
                Config::from_file(path).map_err(|e| anyhow!("{}: {e}", path.display()))?
            }
            None => Config::default(),
        };
        let values = [
            ("plugins/ros2dds/namespace", self.namespace.map(|n| serde_json::json!(n))),
            ("plugins/ros2dds/domain", self.domain.map(|d| serde_json::json!(d))),
            ("listen/endpoints", endpoints(self.listen)),
            ("connect/endpoints", endpoints(self.connect)),
            ("timestamping/enabled", Some(serde_json::json!(true))),
            ("plugins_loading/enabled", Some(serde_json::json!(true))),
            ("adminspace/enabled", Some(serde_json::json!(true))),
        ];
        for (key, value) in values {
            if let Some(value) = value {
                config.insert_json5(key, &value.to_string()).map_err(|e| anyhow!("{key}: {e}"))?;
            }
        }
        if config.mode().is_none() {
            config.set_mode(Some(WhatAmI::Router)).map_err(|_| anyhow!("mode: router"))?;
        }
        Ok(config)
    }
}

fn endpoints(given: Vec<String>) -> Option<serde_json::Value> {
    (!given.is_empty()).then(|| serde_json::json!(given))
}

#[tokio::main]
async fn main() -> Result<()> {
    zenoh::init_log_from_env_or("z=info");
    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<ROS2Plugin, &str>("ros2dds", true);
    let mut runtime = RuntimeBuilder::new(Arguments::parse().config()?)
        .plugins_manager(plugins)
        .build()
        .await
        .map_err(|e| anyhow!("{e}"))?;
    runtime.start().await.map_err(|e| anyhow!("{e}"))?;
    tokio::signal::ctrl_c().await.context("waiting for SIGINT")?;
    Ok(())
}
