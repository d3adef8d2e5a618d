//! What steers the node itself: the six parameter services, and those of the lifecycle.

use super::{
    NodeError,
    handle::{NodeHandle, lock_store},
};
use crate::{
    lifecycle::{LifecycleState, Transition},
    parameters::{
        ParameterKind, ParameterStore, ParameterValue,
        messages::{descriptor_message, value, value_message},
    },
};
use std::sync::{
    Arc, Mutex,
    atomic::{AtomicU8, Ordering},
};
use volant_msgs::{
    lifecycle_msgs::{
        msg::{State, Transition as TransitionMessage, TransitionDescription},
        srv as lifecycle,
    },
    rcl_interfaces::{msg, srv},
};

/// A request that the node's own thread answers.
pub(crate) enum Control {
    /// Set these, all or none.
    Set { changes: Vec<(String, ParameterValue)>, reply: async_channel::Sender<Result<(), String>> },
    /// Change the state of the lifecycle.
    Transition { id: u8, label: String, reply: async_channel::Sender<bool> },
}

/// The state of the lifecycle, for other threads to read.
#[derive(Clone)]
pub(crate) struct SharedState(Arc<AtomicU8>);

impl SharedState {
    pub fn new(state: LifecycleState) -> Self {
        Self(Arc::new(AtomicU8::new(state as u8)))
    }

    pub fn set(&self, state: LifecycleState) {
        self.0.store(state as u8, Ordering::Release);
    }

    pub fn get(&self) -> LifecycleState {
        let number = self.0.load(Ordering::Acquire);
        LifecycleState::ALL.into_iter().find(|s| *s as u8 == number).unwrap_or(LifecycleState::Finalized)
    }
}

fn state_message(state: LifecycleState) -> State {
    State { id: state as u8, label: state.label().to_owned() }
}

pub(crate) fn transition_description(transition: Transition) -> TransitionDescription {
    let (start, goal) = transition.ends();
    TransitionDescription {
        transition: TransitionMessage { id: transition as u8, label: transition.label().to_owned() },
        start_state: state_message(start),
        goal_state: state_message(goal),
    }
}

impl NodeHandle {
    /// Offers the services that every node has.
    pub(crate) fn offer_control(&mut self) -> Result<(), NodeError> {
        self.offer_parameters()?;
        self.offer_lifecycle()
    }

    fn offer_parameters(&mut self) -> Result<(), NodeError> {
        type Store = Arc<Mutex<ParameterStore>>;
        let reading = || -> Store { Arc::clone(&self.store) };
        let store = reading();
        let get = move |request: srv::GetParametersRequest| {
            let store = lock_store(&store);
            let values = request.names.iter().map(|n| value_message(store.get(n))).collect();
            std::future::ready(Some(srv::GetParametersResponse { values }))
        };
        let store = reading();
        let types = move |request: srv::GetParameterTypesRequest| {
            let store = lock_store(&store);
            let types = request.names.iter().map(|n| store.get(n).map_or(0, |v| ParameterKind::of(v) as u8));
            std::future::ready(Some(srv::GetParameterTypesResponse { types: types.collect() }))
        };
        let store = reading();
        let describe = move |request: srv::DescribeParametersRequest| {
            let store = lock_store(&store);
            let descriptors =
                request.names.iter().map(|n| descriptor_message(n, store.descriptor(n))).collect();
            std::future::ready(Some(srv::DescribeParametersResponse { descriptors }))
        };
        let store = reading();
        let list = move |request: srv::ListParametersRequest| {
            let (names, prefixes) = lock_store(&store).list(&request.prefixes, request.depth);
            let result = msg::ListParametersResult { names, prefixes };
            std::future::ready(Some(srv::ListParametersResponse { result }))
        };
        let (inbox, source) = (Arc::clone(&self.sources), self.sources.add_control("parameters", 64));
        let ask = move |parameters: Vec<msg::Parameter>| {
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
                        answer.recv().await.unwrap_or_else(|_| Err("the node did not come to it".to_owned()))
                    }
                };
                msg::SetParametersResult {
                    successful: outcome.is_ok(),
                    reason: outcome.err().unwrap_or_default(),
                }
            }
        };
        let set = {
            let ask = ask.clone();
            move |request: srv::SetParametersRequest| {
                let ask = ask.clone();
                async move {
                    let mut results = Vec::new();
                    for parameter in request.parameters {
                        results.push(ask(vec![parameter]).await);
                    }
                    Some(srv::SetParametersResponse { results })
                }
            }
        };
        let set_all = move |request: srv::SetParametersAtomicallyRequest| {
            let answer = ask(request.parameters);
            async move { Some(srv::SetParametersAtomicallyResponse { result: answer.await }) }
        };
        let tasks = [
            self.serve_with::<srv::GetParameters, _>("~/get_parameters", get)?,
            self.serve_with::<srv::GetParameterTypes, _>("~/get_parameter_types", types)?,
            self.serve_with::<srv::DescribeParameters, _>("~/describe_parameters", describe)?,
            self.serve_with::<srv::ListParameters, _>("~/list_parameters", list)?,
            self.serve_with::<srv::SetParameters, _>("~/set_parameters", set)?,
            self.serve_with::<srv::SetParametersAtomically, _>("~/set_parameters_atomically", set_all)?,
        ];
        self.kit_services.extend(tasks);
        Ok(())
    }

    fn offer_lifecycle(&mut self) -> Result<(), NodeError> {
        let state = self.lifecycle.clone();
        let get = move |_: lifecycle::GetStateRequest| {
            std::future::ready(Some(lifecycle::GetStateResponse {
                current_state: state_message(state.get()),
            }))
        };
        let states = |_: lifecycle::GetAvailableStatesRequest| {
            let available_states = LifecycleState::ALL.into_iter().map(state_message).collect();
            std::future::ready(Some(lifecycle::GetAvailableStatesResponse { available_states }))
        };
        let state = self.lifecycle.clone();
        let transitions = move |_: lifecycle::GetAvailableTransitionsRequest| {
            let now = state.get();
            let available_transitions = Transition::ALL
                .into_iter()
                .filter(|t| t.ends().0 == now)
                .map(transition_description)
                .collect();
            std::future::ready(Some(lifecycle::GetAvailableTransitionsResponse { available_transitions }))
        };
        let graph = |_: lifecycle::GetAvailableTransitionsRequest| {
            let available_transitions = Transition::ALL.into_iter().map(transition_description).collect();
            std::future::ready(Some(lifecycle::GetAvailableTransitionsResponse { available_transitions }))
        };
        let (inbox, source) = (Arc::clone(&self.sources), self.sources.add_control("lifecycle", 8));
        let change = move |request: lifecycle::ChangeStateRequest| {
            let (reply, answer) = async_channel::bounded(1);
            let TransitionMessage { id, label } = request.transition;
            inbox.put_control(source, Control::Transition { id, label, reply });
            async move { Some(lifecycle::ChangeStateResponse { success: answer.recv().await.unwrap_or(false) }) }
        };
        let tasks = [
            self.serve_with::<lifecycle::GetState, _>("~/get_state", get)?,
            self.serve_with::<lifecycle::GetAvailableStates, _>("~/get_available_states", states)?,
            self.serve_with::<lifecycle::GetAvailableTransitions, _>(
                "~/get_available_transitions",
                transitions,
            )?,
            self.serve_with::<lifecycle::GetAvailableTransitions, _>("~/get_transition_graph", graph)?,
            self.serve_with::<lifecycle::ChangeState, _>("~/change_state", change)?,
        ];
        self.kit_services.extend(tasks);
        Ok(())
    }
}
