//! Runs a node on its own thread: main loop, lifecycle, changes of parameters, end.

use super::{
    context::NodeContext,
    control_services::{SharedState, description},
    domain::Domain,
    error::NodeError,
    handle::NodeParts,
    publisher::Publisher,
    shell::NodeShell,
};
use crate::{
    inbox::{Control, Event, Inbox, Sources, Taken, now},
    level::Level,
    lifecycle::{LifecycleState, Transition},
    parameters::{CommonParameters, ParameterSet, ParameterValue},
    qos::Qos,
};
use std::{
    sync::{Arc, mpsc::SyncSender},
    time::{Duration, Instant},
};
use volant_msgs::lifecycle_msgs::msg::{TransitionDescription, TransitionEvent};

/// Period of the shell's tick and the diagnostics.
const TICK: Duration = Duration::from_secs(1);
const TRANSITION_EVENTS: Qos = Qos { max_samples: 100, ..Qos::RELIABLE };

/// Creates the shell of a node.
type Start<S> = Box<
    dyn FnMut(
        &mut NodeContext<<S as NodeShell>::Input>,
        <S as NodeShell>::Parameters,
    ) -> Result<S, NodeError>,
>;

struct NodeRunner<S: NodeShell> {
    // Dropped before the context, so that its publishers and devices end before the node.
    shell: Option<S>,
    start: Start<S>,
    state: SharedState,
    events: Publisher<TransitionEvent>,
    context: NodeContext<S::Input>,
}

/// Runs a node until its inbox is closed. `started` is sent when the node has started, and drops
/// unused if it cannot start.
///
/// # Errors
/// Why the node cannot start, or why it ended on its own.
pub(crate) fn run<S: NodeShell>(
    domain: Arc<Domain>,
    inbox: Arc<Inbox<S::Input>>,
    parts: NodeParts,
    start: Start<S>,
    started: &SyncSender<()>,
) -> Result<(), NodeError> {
    // Invalid values end the node now, whether or not it starts active.
    S::Parameters::from_map(parts.store.values())?;
    let CommonParameters { autostart, .. } = CommonParameters::from_map(parts.store.values())?;
    let mut context = NodeContext::new(domain, inbox, parts)?;
    context.set_active(false);
    let events = context.endpoints.advertise_always("~/transition_event", TRANSITION_EVENTS)?;
    context.offer_control()?;
    let mut runner =
        NodeRunner::<S> { shell: None, start, state: context.lifecycle.clone(), events, context };
    if autostart {
        // Active before the start, so that what a node publishes in it is published.
        runner.context.set_active(true);
        runner.change(Transition::CONFIGURE)?;
        runner.change(Transition::ACTIVATE)?;
    }
    let all: Vec<_> = runner.context.parameter_store().values().clone().into_iter().collect();
    runner.context.announce(&all);
    let _ = started.send(());
    runner.run();
    runner.context.ending.take().unwrap_or(Ok(()))
}

impl<S: NodeShell> NodeRunner<S> {
    fn run(&mut self) {
        let supervised = self.context.endpoints.domain.supervisor.add_loop();
        let mut next_tick = now() + TICK;
        loop {
            supervised.passed();
            let timer = if self.is_active() { self.context.next_timer() } else { None };
            let beat = supervised.interval().map(|interval| now() + interval);
            let deadline = [timer, beat].into_iter().flatten().fold(next_tick, Instant::min);
            match self.context.inbox.take(deadline) {
                Taken::Entry(Event::Input(input)) => {
                    if let Some(shell) = &mut self.shell {
                        shell.handle(&mut self.context, input);
                    }
                }
                Taken::Entry(Event::Control(control)) => self.control(control),
                Taken::Deadline => {}
                Taken::Closed => return,
            }
            if self.is_active()
                && let Some(shell) = &mut self.shell
            {
                // One input of each: a handler slower than a period holds up nothing else.
                for input in self.context.due_timers() {
                    shell.handle(&mut self.context, input);
                }
            }
            let late = now().saturating_duration_since(next_tick);
            if now() >= next_tick {
                self.context.diagnostics.ticked(late);
                next_tick = now() + TICK;
                if self.is_active()
                    && let Some(shell) = &mut self.shell
                {
                    shell.tick(&mut self.context);
                }
                self.context.publish_diagnostics();
            }
        }
    }

    fn is_active(&self) -> bool {
        *self.state.lock() == LifecycleState::Active
    }

    fn control(&mut self, control: Control) {
        match control {
            Control::Wake => {}
            Control::Set { changes, reply } => {
                let _ = reply.try_send(self.set(&changes));
            }
            Control::Transition { id, label, reply } => {
                let _ = reply.try_send(self.request(id, &label));
            }
        }
    }

    /// Changes the state on request, if that is possible; returns whether it succeeded.
    fn request(&mut self, id: u8, label: &str) -> bool {
        let state = *self.state.lock();
        let Some(transition) = Transition::requested(state, id, label) else {
            let from = state.label();
            let text = format!("the transition {id} `{label}` is not possible from {from}");
            self.context.log(Level::Warn, text);
            return false;
        };
        let outcome = self.change(transition);
        if let Err(error) = &outcome {
            self.context.log(Level::Error, format!("cannot {}: {error}", transition.label));
        }
        outcome.is_ok()
    }

    fn set(&mut self, changes: &[(String, ParameterValue)]) -> Result<(), String> {
        let (values, made) =
            self.context.parameter_store().propose(changes).map_err(|e| e.to_string())?;
        let parameters = S::Parameters::from_map(&values).map_err(|e| e.to_string())?;
        if let Some(shell) = &mut self.shell {
            shell.parameters_changed(&mut self.context, &parameters)?;
        }
        self.context.parameter_store().commit(values);
        self.context.announce(&made);
        if made.iter().any(|(name, _)| name == "use_sim_time") {
            self.context.follow_use_sim_time().map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    fn change(&mut self, transition: Transition) -> Result<(), NodeError> {
        let Transition { id, label, start, through, goal } = transition;
        self.enter((id, label), start, through);
        let mut outcome = Ok(());
        match through {
            LifecycleState::Configuring => outcome = self.configure(),
            LifecycleState::Activating => self.context.set_active(true),
            LifecycleState::Deactivating => self.context.set_active(false),
            _ => {
                self.context.set_active(false);
                self.clean_up();
            }
        }
        let success = outcome.is_ok();
        self.enter(transition.end(success), through, if success { goal } else { start });
        outcome
    }

    /// Enters a state and publishes that, as rcl does for both halves of a transition.
    fn enter(&self, transition: (u8, &str), from: LifecycleState, to: LifecycleState) {
        *self.state.lock() = to;
        let TransitionDescription { transition, start_state, goal_state } =
            description(transition, from, to);
        let timestamp = u64::try_from(self.context.now().as_nanos()).unwrap_or(0);
        self.events.publish(TransitionEvent { timestamp, transition, start_state, goal_state });
    }

    fn configure(&mut self) -> Result<(), NodeError> {
        let parameters = S::Parameters::from_map(self.context.parameter_store().values())?;
        match (self.start)(&mut self.context, parameters) {
            Ok(shell) => self.shell = Some(shell),
            Err(error) => {
                self.clean_up();
                return Err(error);
            }
        }
        for mistake in self.context.parameter_store().left_over() {
            self.context.log(Level::Warn, mistake.to_string());
        }
        Ok(())
    }

    /// Ends the devices, then the shell with its publishers, then its subscriptions, services and
    /// timers.
    fn clean_up(&mut self) {
        self.context.end_devices();
        self.shell = None;
        self.context.clear_shell();
    }
}

impl<S: NodeShell> Drop for NodeRunner<S> {
    fn drop(&mut self) {
        self.context.inbox.close();
        self.clean_up();
        // The context's fields drop the rest: subscriptions, reader thread, DDS node, in this
        // order.
    }
}
