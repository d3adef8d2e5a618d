//! Network settings from ROS 2's environment variables.

use std::path::PathBuf;
use thiserror::Error;

/// An environment variable with an invalid value: both, and the valid values.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("the environment variable {0}")]
pub struct EnvironmentError(String);

/// Range of discovery.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DiscoveryRange {
    /// Only this host: `ROS_LOCALHOST_ONLY=1`, or `ROS_AUTOMATIC_DISCOVERY_RANGE` `LOCALHOST` or
    /// `OFF` (RustDDS 0.15.1 cannot turn off discovery on the host).
    Localhost,
    /// The local network: `SUBNET` and `SYSTEM_DEFAULT`, and ROS 2's default.
    #[default]
    Subnet,
}

/// Wire format of services.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ServiceFlavour {
    /// Fast DDS, Connext and RustDDS: the request's identity is beside the payload.
    #[default]
    Enhanced,
    /// Cyclone DDS: it is inside the payload.
    Cyclone,
}

/// The DDS domain of a process, and how it joins.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Network {
    /// `ROS_DOMAIN_ID`, 0 to 232.
    pub domain_id: u16,
    /// Range of discovery.
    pub range: DiscoveryRange,
    /// From `RMW_IMPLEMENTATION`.
    pub services: ServiceFlavour,
    /// `ROS_SECURITY_ENABLE` and its companions; `None` without security.
    pub security: Option<Security>,
}

/// Enclave of an SROS 2 keystore, with which a process authenticates itself and others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Security {
    /// `ROS_SECURITY_KEYSTORE`.
    pub keystore: PathBuf,
    /// The enclave's absolute name: `ROS_SECURITY_ENCLAVE_OVERRIDE`, else `--enclave`, else `/`.
    pub enclave: String,
    /// `ROS_SECURITY_STRATEGY=Enforce`: without its keys the process does not start. Otherwise it
    /// starts unprotected, with a warning, as in rcl.
    pub enforce: bool,
}

impl Security {
    /// An enclave of a keystore, enforced.
    pub fn enforced(keystore: impl Into<PathBuf>, enclave: impl Into<String>) -> Self {
        Self { keystore: keystore.into(), enclave: enclave.into(), enforce: true }
    }

    /// Folder of the enclave's certificates, keys and permissions.
    pub fn folder(&self) -> PathBuf {
        self.keystore.join("enclaves").join(self.enclave.trim_start_matches('/'))
    }
}

impl Network {
    /// Reads the environment of this process.
    ///
    /// # Errors
    /// [`EnvironmentError`] for a value that ROS 2 does not define.
    pub fn from_environment() -> Result<Self, EnvironmentError> {
        Self::from_environment_in(None)
    }

    /// Reads the environment of this process, with the enclave of its command line
    /// (`--ros-args --enclave /rig/climber`).
    ///
    /// # Errors
    /// As [`Network::from_environment`].
    pub fn from_environment_in(enclave: Option<&str>) -> Result<Self, EnvironmentError> {
        Self::from_variables(|name| std::env::var(name).ok(), enclave)
    }

    /// Reads variables with `get`; an empty value counts as not set, as in rcl.
    fn from_variables(
        get: impl Fn(&str) -> Option<String>,
        enclave: Option<&str>,
    ) -> Result<Self, EnvironmentError> {
        let get = |name| get(name).filter(|value| !value.is_empty());
        let wrong = |name: &str, value: String, expected: &str| {
            EnvironmentError(format!("{name}={value} is not understood; expected {expected}"))
        };
        for (name, is_unsupported, expected) in UNSUPPORTED {
            if let Some(value) = get(name).filter(|value| is_unsupported(value)) {
                return Err(wrong(name, value, expected));
            }
        }
        let domain_id = match get("ROS_DOMAIN_ID") {
            None => 0,
            Some(value) => value.parse().ok().filter(|id| *id <= 232).ok_or_else(|| {
                wrong("ROS_DOMAIN_ID", value, "a number from 0 to 232 (UDP has no ports for more)")
            })?,
        };
        let range = match get("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            _ if get("ROS_LOCALHOST_ONLY").as_deref() == Some("1") => DiscoveryRange::Localhost,
            Some("LOCALHOST" | "OFF") => DiscoveryRange::Localhost,
            None | Some("SUBNET" | "SYSTEM_DEFAULT") => DiscoveryRange::Subnet,
            Some(value) => {
                let expected = "SUBNET, LOCALHOST, OFF or SYSTEM_DEFAULT";
                return Err(wrong("ROS_AUTOMATIC_DISCOVERY_RANGE", value.to_owned(), expected));
            }
        };
        let services = match get("RMW_IMPLEMENTATION").as_deref() {
            Some("rmw_cyclonedds_cpp") => ServiceFlavour::Cyclone,
            _ => ServiceFlavour::Enhanced,
        };
        // rcl accepts this one value.
        let security = match get("ROS_SECURITY_ENABLE").as_deref() {
            Some("true") => {
                let keystore = get("ROS_SECURITY_KEYSTORE").ok_or_else(|| {
                    let expected = "the keystore's folder, because ROS_SECURITY_ENABLE is true";
                    wrong("ROS_SECURITY_KEYSTORE", String::new(), expected)
                })?;
                let overriding = get("ROS_SECURITY_ENCLAVE_OVERRIDE");
                Some(Security {
                    keystore: keystore.into(),
                    enclave: overriding.unwrap_or_else(|| enclave.unwrap_or("/").to_owned()),
                    enforce: get("ROS_SECURITY_STRATEGY").as_deref() == Some("Enforce"),
                })
            }
            _ => None,
        };
        Ok(Self { domain_id, range, services, security })
    }

    /// Returns a warning for each variable of other middleware that has no effect here.
    pub fn ignored_variables() -> Vec<String> {
        PROFILES
            .into_iter()
            .filter(|name| std::env::var_os(name).is_some_and(|value| !value.is_empty()))
            .map(|name| {
                format!(
                    "{name} is set, but RustDDS reads no profile: its settings do not apply to this \
                     process (QoS: parameters `qos_overrides.…`; network: ROS_LOCALHOST_ONLY, \
                     ROS_AUTOMATIC_DISCOVERY_RANGE)"
                )
            })
            .collect()
    }
}

/// Profiles of Fast DDS, Cyclone DDS and Connext.
const PROFILES: [&str; 4] = [
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "CYCLONEDDS_URI",
    "NDDS_QOS_PROFILES",
];

/// Middleware that communicates by DDS.
const DDS: [&str; 4] =
    ["rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp", "rmw_connextdds"];

/// Whether a value of a variable is not supported.
type Matches = fn(&str) -> bool;

/// Settings with which this process would find nobody: variable, whether a value of it is such a
/// setting, and what is expected.
const UNSUPPORTED: [(&str, Matches, &str); 4] = [
    (
        "ROS_STATIC_PEERS",
        |_| true,
        "nothing: RustDDS 0.15.1 discovers by multicast only; unset it for this process, and \
         connect networks without multicast by a bridge",
    ),
    (
        "ROS_DISCOVERY_SERVER",
        |_| true,
        "nothing: RustDDS 0.15.1 has no discovery server; unset it in all processes of the rig",
    ),
    (
        "RMW_IMPLEMENTATION",
        |rmw| !DDS.contains(&rmw),
        "rmw_fastrtps_cpp, rmw_cyclonedds_cpp or rmw_connextdds: this process communicates by DDS",
    ),
    (
        "ROS_DISTRO",
        |distro| OLD_DISTROS.contains(&distro),
        "iron, jazzy or a later one: Humble and older announce nodes in another format, and \
         neither side could read the other's; run this process where that ROS is not sourced, and \
         exchange bags or connect newer computers",
    ),
];

/// Distributions whose `ros_discovery_info` has ids of 24 bytes instead of 16.
const OLD_DISTROS: [&str; 8] =
    ["ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble"];

#[cfg(test)]
mod tests {
    use super::*;

    fn network(variables: &[(&str, &str)]) -> Result<Network, EnvironmentError> {
        network_in(None, variables)
    }

    fn network_in(
        enclave: Option<&str>,
        variables: &[(&str, &str)],
    ) -> Result<Network, EnvironmentError> {
        let get = |name: &str| {
            variables.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned())
        };
        Network::from_variables(get, enclave)
    }

    #[test]
    fn the_variables_are_those_of_rcl() {
        assert_eq!(network(&[]).unwrap(), Network::default());
        assert_eq!(network(&[("ROS_DOMAIN_ID", "")]).unwrap().domain_id, 0);
        assert_eq!(network(&[("ROS_DOMAIN_ID", "42")]).unwrap().domain_id, 42);
        for (variables, range) in [
            (vec![("ROS_LOCALHOST_ONLY", "1")], DiscoveryRange::Localhost),
            (vec![("ROS_LOCALHOST_ONLY", "0")], DiscoveryRange::Subnet),
            (vec![("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")], DiscoveryRange::Localhost),
            (vec![("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")], DiscoveryRange::Subnet),
        ] {
            assert_eq!(network(&variables).unwrap().range, range, "{variables:?}");
        }
        for distro in ["iron", "jazzy", "kilted", "rolling"] {
            assert_eq!(network(&[("ROS_DISTRO", distro)]), Ok(Network::default()));
        }
        let cyclone = network(&[("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")]).unwrap();
        assert_eq!(cyclone.services, ServiceFlavour::Cyclone);
    }

    #[test]
    fn the_security_variables_are_those_of_sros_2() {
        assert_eq!(network(&[("ROS_SECURITY_ENABLE", "yes")]).unwrap().security, None);
        let missing = network(&[("ROS_SECURITY_ENABLE", "true")]).unwrap_err().to_string();
        assert!(missing.contains("ROS_SECURITY_KEYSTORE"), "{missing}");
        let enabled = [("ROS_SECURITY_ENABLE", "true"), ("ROS_SECURITY_KEYSTORE", "/keys")];
        let security = network(&enabled).unwrap().security.unwrap();
        assert!(!security.enforce && security.folder() == std::path::Path::new("/keys/enclaves"));
        let named = network_in(Some("/rig/climber"), &enabled).unwrap().security.unwrap();
        assert_eq!(named.folder(), PathBuf::from("/keys/enclaves/rig/climber"));
        let mut more = enabled.to_vec();
        more.extend([
            ("ROS_SECURITY_ENCLAVE_OVERRIDE", "/b"),
            ("ROS_SECURITY_STRATEGY", "Enforce"),
        ]);
        let overridden = network_in(Some("/a"), &more).unwrap().security.unwrap();
        assert!(
            overridden.enforce && overridden.folder() == std::path::Path::new("/keys/enclaves/b")
        );
    }

    #[test]
    fn an_invalid_value_is_named() {
        for (name, value) in [
            ("ROS_DOMAIN_ID", "233"),
            ("ROS_DOMAIN_ID", "x"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FAR"),
            ("ROS_STATIC_PEERS", "192.168.0.2"),
            ("ROS_DISCOVERY_SERVER", "192.168.0.2:11811"),
            ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
            ("ROS_DISTRO", "humble"),
        ] {
            let error = network(&[(name, value)]).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(value), "{error}");
        }
    }
}
