//! `~/get_type_description`: the fields and texts of the node's types (REP-2016).

use super::{endpoints::Endpoints, error::NodeError, service::OfferedService};
use volant_msgs::{
    MessageInfo, SERVICES, description,
    type_description_interfaces::srv::{
        GetTypeDescription, GetTypeDescriptionRequest, GetTypeDescriptionResponse,
    },
};

/// Offers the service.
pub(crate) fn offer(endpoints: &mut Endpoints) -> Result<OfferedService, NodeError> {
    endpoints.serve::<GetTypeDescription, _>("~/get_type_description", |request| {
        std::future::ready(Some(answer(&request)))
    })
}

fn answer(request: &GetTypeDescriptionRequest) -> GetTypeDescriptionResponse {
    let GetTypeDescriptionRequest { type_name, type_hash, include_type_sources } = request;
    let failed = |failure_reason: String| GetTypeDescriptionResponse {
        failure_reason,
        ..GetTypeDescriptionResponse::default()
    };
    let hash = MessageInfo::by_name(type_name)
        .map(|m| m.rihs01_hash)
        .or_else(|| SERVICES.iter().find(|(name, _)| name == type_name).map(|(_, hash)| *hash));
    match (hash, description::describe(type_name)) {
        (Some(known), Some(_)) if !type_hash.is_empty() && type_hash != known => {
            failed(format!("the hash of {type_name} is {known} here, not {type_hash}"))
        }
        (Some(_), Some((type_description, sources))) => GetTypeDescriptionResponse {
            successful: true,
            type_description,
            type_sources: if *include_type_sources { sources } else { vec![] },
            ..GetTypeDescriptionResponse::default()
        },
        _ => failed(format!("this node does not know the type {type_name}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(type_name: &str, type_hash: &str, sources: bool) -> GetTypeDescriptionResponse {
        answer(&GetTypeDescriptionRequest {
            type_name: type_name.to_owned(),
            type_hash: type_hash.to_owned(),
            include_type_sources: sources,
        })
    }

    #[test]
    fn a_type_is_described_if_name_and_hash_are_known() {
        let name = "sensor_msgs/msg/Imu";
        let hash = MessageInfo::by_name(name).unwrap().rihs01_hash;
        for (hash, sources) in [("", true), (hash, false)] {
            let response = asked(name, hash, sources);
            assert!(response.successful, "{}", response.failure_reason);
            assert_eq!(response.type_description.type_description.type_name, name);
            assert_eq!(!response.type_sources.is_empty(), sources);
        }
        assert!(asked("std_srvs/srv/Trigger", "", true).successful);
        let other = asked(name, "RIHS01_0", true);
        assert!(!other.successful && other.failure_reason.contains(hash), "{other:?}");
        assert!(asked("a/msg/B", "", true).failure_reason.contains("a/msg/B"));
        // Half of a service has a description, but is no type of a topic or service.
        assert!(!asked("std_srvs/srv/Trigger_Request", "", true).successful);
    }
}
