//! Services that every node offers: parameters and lifecycle.

use super::{endpoints::Endpoints, error::NodeError, service::OfferedService, type_description};
use crate::{
    inbox::{Control, SourceKind},
    lifecycle::{LifecycleState, Transition},
    parameters::{
        CommonParameters, ParameterKind, ParameterSet,
        messages::{descriptor_message, value, value_message},
    },
};
use parking_lot::Mutex;
use std::sync::Arc;
use volant_msgs::{
    lifecycle_msgs::{
        msg::{State, Transition as TransitionMessage, TransitionDescription},
        srv as lifecycle,
    },
    rcl_interfaces::{msg, srv},
};

/// Lifecycle state, shared with the thread that serves it.
pub(crate) type SharedState = Arc<Mutex<LifecycleState>>;

fn state_message(state: LifecycleState) -> State {
    State { id: state as u8, label: state.label() }
}

/// Description of a transition by its number and name.
pub(crate) fn description(
    (id, label): (u8, &str),
    start: LifecycleState,
    goal: LifecycleState,
) -> TransitionDescription {
    TransitionDescription {
        transition: TransitionMessage { id, label: label.to_owned() },
        start_state: state_message(start),
        goal_state: state_message(goal),
    }
}

/// Offers the services that every node has: six for parameters, five for the lifecycle, and the
/// description of its types.
pub(crate) fn offer(
    endpoints: &mut Endpoints,
    state: &SharedState,
) -> Result<Vec<OfferedService>, NodeError> {
    let mut tasks = Vec::from(offer_parameters(endpoints)?);
    tasks.extend(offer_lifecycle(endpoints, state)?);
    let common = CommonParameters::from_map(endpoints.store.lock().values())?;
    if common.start_type_description_service {
        tasks.push(type_description::offer(endpoints)?);
    }
    Ok(tasks)
}

fn offer_parameters(endpoints: &mut Endpoints) -> Result<[OfferedService; 6], NodeError> {
    let store = Arc::clone(&endpoints.store);
    let get = move |request: srv::GetParametersRequest| {
        let store = store.lock();
        let values = request.names.iter().map(|n| value_message(store.get(n))).collect();
        std::future::ready(Some(srv::GetParametersResponse { values }))
    };
    let store = Arc::clone(&endpoints.store);
    let types = move |request: srv::GetParameterTypesRequest| {
        let store = store.lock();
        let types =
            request.names.iter().map(|n| store.get(n).map_or(0, |v| ParameterKind::of(v) as u8));
        std::future::ready(Some(srv::GetParameterTypesResponse { types: types.collect() }))
    };
    let store = Arc::clone(&endpoints.store);
    let describe = move |request: srv::DescribeParametersRequest| {
        let store = store.lock();
        let descriptors =
            request.names.iter().map(|n| descriptor_message(n, store.descriptor(n))).collect();
        std::future::ready(Some(srv::DescribeParametersResponse { descriptors }))
    };
    let store = Arc::clone(&endpoints.store);
    let list = move |request: srv::ListParametersRequest| {
        let (names, prefixes) = store.lock().list(&request.prefixes, request.depth);
        let result = msg::ListParametersResult { names, prefixes };
        std::future::ready(Some(srv::ListParametersResponse { result }))
    };
    let inbox = Arc::clone(&endpoints.sources);
    let source = inbox.add_source("parameters", 64, SourceKind::Control);
    let apply = move |parameters: Vec<msg::Parameter>| {
        let inbox = Arc::clone(&inbox);
        async move {
            let changes: Result<Vec<_>, _> = parameters
                .into_iter()
                .map(|p| value(&p.value).map(|v| (p.name.clone(), v)).ok_or(p.name))
                .collect();
            let outcome = match changes {
                Err(name) => Err(format!("the parameter `{name}` cannot be unset or hold bytes")),
                Ok(changes) => {
                    let (reply, answer) = async_channel::bounded(1);
                    inbox.put_control(source, Control::Set { changes, reply });
                    answer.recv().await.unwrap_or_else(|_| {
                        Err("the node ended or has too many changes waiting".to_owned())
                    })
                }
            };
            msg::SetParametersResult {
                successful: outcome.is_ok(),
                reason: outcome.err().unwrap_or_default(),
            }
        }
    };
    let set = {
        let apply = apply.clone();
        move |request: srv::SetParametersRequest| {
            let apply = apply.clone();
            async move {
                let mut results = Vec::new();
                for parameter in request.parameters {
                    results.push(apply(vec![parameter]).await);
                }
                Some(srv::SetParametersResponse { results })
            }
        }
    };
    let set_all = move |request: srv::SetParametersAtomicallyRequest| {
        let answer = apply(request.parameters);
        async move { Some(srv::SetParametersAtomicallyResponse { result: answer.await }) }
    };
    Ok([
        endpoints.serve::<srv::GetParameters, _>("~/get_parameters", get)?,
        endpoints.serve::<srv::GetParameterTypes, _>("~/get_parameter_types", types)?,
        endpoints.serve::<srv::DescribeParameters, _>("~/describe_parameters", describe)?,
        endpoints.serve::<srv::ListParameters, _>("~/list_parameters", list)?,
        endpoints.serve::<srv::SetParameters, _>("~/set_parameters", set)?,
        endpoints
            .serve::<srv::SetParametersAtomically, _>("~/set_parameters_atomically", set_all)?,
    ])
}

fn offer_lifecycle(
    endpoints: &mut Endpoints,
    state: &SharedState,
) -> Result<[OfferedService; 5], NodeError> {
    let own_state = Arc::clone(state);
    let get = move |_: lifecycle::GetStateRequest| {
        std::future::ready(Some(lifecycle::GetStateResponse {
            current_state: state_message(*own_state.lock()),
        }))
    };
    let states = |_: lifecycle::GetAvailableStatesRequest| {
        let available_states = LifecycleState::ALL.into_iter().map(state_message).collect();
        std::future::ready(Some(lifecycle::GetAvailableStatesResponse { available_states }))
    };
    let transitions = |from: Option<LifecycleState>| {
        let all = Transition::ALL.into_iter().filter(|t| from.is_none_or(|s| t.start == s));
        let mut available_transitions: Vec<_> =
            all.map(|t| description((t.id, t.label), t.start, t.through)).collect();
        if from.is_none() {
            let ends = Transition::ALL.map(|t| description(t.end(true), t.through, t.goal));
            available_transitions.extend(ends);
            // The three shutdowns end alike.
            available_transitions.dedup();
        }
        let response = lifecycle::GetAvailableTransitionsResponse { available_transitions };
        std::future::ready(Some(response))
    };
    let state = Arc::clone(state);
    let available =
        move |_: lifecycle::GetAvailableTransitionsRequest| transitions(Some(*state.lock()));
    let graph = move |_: lifecycle::GetAvailableTransitionsRequest| transitions(None);
    let inbox = Arc::clone(&endpoints.sources);
    let source = inbox.add_source("lifecycle", 8, SourceKind::Control);
    let change = move |request: lifecycle::ChangeStateRequest| {
        let (reply, answer) = async_channel::bounded(1);
        let TransitionMessage { id, label } = request.transition;
        inbox.put_control(source, Control::Transition { id, label, reply });
        async move {
            Some(lifecycle::ChangeStateResponse { success: answer.recv().await.unwrap_or(false) })
        }
    };
    Ok([
        endpoints.serve::<lifecycle::GetState, _>("~/get_state", get)?,
        endpoints.serve::<lifecycle::GetAvailableStates, _>("~/get_available_states", states)?,
        endpoints.serve::<lifecycle::GetAvailableTransitions, _>(
            "~/get_available_transitions",
            available,
        )?,
        endpoints
            .serve::<lifecycle::GetAvailableTransitions, _>("~/get_transition_graph", graph)?,
        endpoints.serve::<lifecycle::ChangeState, _>("~/change_state", change)?,
    ])
}
