//! The one place that creates a DDS participant, for nodes and for tools alike: security enclave,
//! discovery range and the watch over the middleware's threads are the same everywhere.
//!
//! Static peers and a discovery server are rejected ([`Network::from_environment`]): RustDDS 0.15.1
//! discovers by multicast only.

use super::{
    clock::Clock,
    error::NodeError,
    logger::{Logger, Sinks},
    middleware::MiddlewareWatch,
};
use crate::{
    environment::{DiscoveryRange, Network, Security},
    level::Level,
};
use rustdds::{DomainParticipant, DomainParticipantBuilder};
use std::{net::Ipv4Addr, path::PathBuf};

/// Joins a DDS domain: creates a participant with the domain, discovery range and security of
/// `network` ([`Network::from_environment`]), and a watch that reports when it becomes unusable.
///
/// # Errors
/// `ROS_SECURITY_STRATEGY` is `Enforce` and the enclave is missing or invalid, or DDS fails to
/// create the participant (no network interface, no ports).
pub fn join(network: &Network) -> Result<(DomainParticipant, MiddlewareWatch), NodeError> {
    join_with(network, &process_log())
}

/// The same with a log of its own.
#[allow(clippy::disallowed_methods, reason = "the one place")]
pub(super) fn join_with(
    network: &Network,
    log: &Logger,
) -> Result<(DomainParticipant, MiddlewareWatch), NodeError> {
    // As every rmw announces it; `/` without security.
    let enclave = network.security.as_ref().map_or("/", |security| security.enclave.as_str());
    let mut builder = DomainParticipantBuilder::new(network.domain_id)
        .with_user_data(format!("enclave={enclave};").into_bytes());
    if network.range == DiscoveryRange::Localhost {
        builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
    }
    if let Some(security) = &network.security {
        builder = secure(builder, security, log)?;
    }
    let (participant, watch) = MiddlewareWatch::of(|| builder.build());
    let participant = participant.map_err(|e| {
        NodeError::middleware(format!("the participant in domain {}", network.domain_id), e)
    })?;
    Ok((participant, watch))
}

/// Log of a program without nodes.
fn process_log() -> Logger {
    Logger::new("volant".to_owned(), Level::Info, Clock::default(), Sinks::default())
}

/// Files of an enclave.
const ENCLAVE: [&str; 6] = [
    "cert.pem",
    "key.pem",
    "identity_ca.cert.pem",
    "permissions_ca.cert.pem",
    "governance.p7s",
    "permissions.p7s",
];

/// Puts the participant into its security enclave.
fn secure(
    builder: DomainParticipantBuilder,
    security: &Security,
    log: &Logger,
) -> Result<DomainParticipantBuilder, NodeError> {
    let folder = security.folder();
    let missing = ENCLAVE.into_iter().map(|name| folder.join(name)).find(|file| !file.is_file());
    let (keystore, enclave) = (security.keystore.display(), &security.enclave);
    let reason = if let Some(file) = missing {
        format!(
            "{} is missing; create the enclave with `make-keystore {keystore} {enclave}` or \
             `ros2 security create_enclave {keystore} {enclave}`, or name another one with \
             ROS_SECURITY_ENCLAVE_OVERRIDE",
            file.display()
        )
    } else if cfg!(not(feature = "security")) {
        "this program was built without DDS security; build it with \
         `--features node_kit/security`"
            .to_owned()
    } else {
        log.log(Level::Info, format!("DDS security: {}", folder.display()));
        return Ok(with_keys(builder, folder));
    };
    if security.enforce {
        return Err(NodeError::shell(format!(
            "DDS security: the enclave {enclave} of the keystore {keystore}: {reason}"
        )));
    }
    log.log(
        Level::Warn,
        format!(
            "ROS_SECURITY_ENABLE is set, but this process runs UNPROTECTED: {reason} \
             (ROS_SECURITY_STRATEGY=Enforce forbids that)"
        ),
    );
    Ok(builder)
}

#[cfg(feature = "security")]
fn with_keys(builder: DomainParticipantBuilder, folder: PathBuf) -> DomainParticipantBuilder {
    builder.builtin_security(rustdds::DomainParticipantSecurityConfigFiles::with_ros_default_names(
        folder,
        String::new(),
    ))
}

#[cfg(not(feature = "security"))]
fn with_keys(builder: DomainParticipantBuilder, _: PathBuf) -> DomainParticipantBuilder {
    builder
}
