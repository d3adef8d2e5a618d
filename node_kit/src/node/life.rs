//! A node's life on its own thread: the loop, the lifecycle, the change of parameters, the end.

use super::{
    NodeError, NodeShell,
    control::{Control, SharedState, transition_description},
    domain::Domain,
    handle::KitParts,
    kit::{Event, Kit},
    publisher::Publisher,
};
use crate::{
    inbox::{Inbox, Taken, now},
    level::Level,
    lifecycle::{LifecycleState, Transition},
    parameters::{ParameterSet, ParameterValue},
    qos::Qos,
};
use std::{
    sync::{Arc, mpsc::SyncSender},
    time::Duration,
};
use volant_msgs::lifecycle_msgs::msg::TransitionEvent;

/// Once a second: the shell's tick, then the diagnostics.
const TICK: Duration = Duration::from_secs(1);
const TRANSITION_EVENTS: Qos = Qos { reliable: true, transient_local: false, depth: 10, max_samples: 100 };

struct Life<S: NodeShell> {
    // Dropped before the kit, so that its publishers and devices are gone when the node is.
    shell: Option<S>,
    state: SharedState,
    events: Publisher<TransitionEvent>,
    kit: Kit<S::Input>,
}

/// All of it. `started` is told when the node has started; it drops unused where it cannot.
pub(crate) fn live<S: NodeShell>(
    domain: Arc<Domain>,
    inbox: Inbox<Event<S::Input>>,
    parts: KitParts,
    started: &SyncSender<()>,
) -> Result<(), NodeError> {
    // Wrong values end the node now, whether or not it starts active.
    S::Parameters::from_map(parts.store.values())?;
    let autostart = parts.store.get("autostart") != Some(&ParameterValue::Bool(false));
    let mut kit = Kit::new(domain, inbox, parts)?;
    kit.set_active(false);
    let events = kit.advertise_always("~/transition_event", TRANSITION_EVENTS)?;
    kit.offer_control()?;
    let mut life = Life::<S> { shell: None, state: kit.lifecycle.clone(), events, kit };
    if autostart {
        // Active from the first: what a node publishes in its start is meant to be heard.
        life.kit.set_active(true);
        life.change(Transition::Configure)?;
        life.change(Transition::Activate)?;
    }
    life.kit.announce_parameters();
    let _ = started.send(());
    life.run();
    life.kit.ending.take().unwrap_or(Ok(()))
}

impl<S: NodeShell> Life<S> {
    fn run(&mut self) {
        let mut next_tick = now() + TICK;
        loop {
            let active = self.state.get() == LifecycleState::Active;
            let timer = if active { self.kit.next_timer() } else { None };
            let deadline = timer.map_or(next_tick, |timer| timer.min(next_tick));
            match self.kit.inbox.take(Some(deadline)) {
                Taken::Entry(Event::Input(input)) => {
                    if let Some(shell) = &mut self.shell {
                        shell.handle(&mut self.kit, input);
                    }
                }
                Taken::Entry(Event::Control(control)) => self.control(control),
                Taken::Entry(Event::Wake) | Taken::Deadline => {}
                Taken::Closed => return,
            }
            if self.state.get() == LifecycleState::Active
                && let Some(shell) = &mut self.shell
            {
                while let Some(input) = self.kit.due_timer() {
                    shell.handle(&mut self.kit, input);
                }
            }
            let late = now().saturating_duration_since(next_tick);
            if now() >= next_tick {
                self.kit.stood_still(late);
                next_tick = now() + TICK;
                if self.state.get() == LifecycleState::Active
                    && let Some(shell) = &mut self.shell
                {
                    shell.tick(&mut self.kit);
                }
                self.kit.publish_diagnostics();
            }
        }
    }

    fn control(&mut self, control: Control) {
        match control {
            Control::Set { changes, reply } => {
                let _ = reply.try_send(self.set(&changes));
            }
            Control::Transition { id, label, reply } => {
                let success = match Transition::requested(self.state.get(), id, &label) {
                    None => {
                        let state = self.state.get().label();
                        self.kit.log(
                            Level::Warn,
                            format!("the transition {id} `{label}` is not possible from {state}"),
                        );
                        false
                    }
                    Some(transition) => match self.change(transition) {
                        Ok(()) => true,
                        Err(error) => {
                            self.kit.log(Level::Error, format!("cannot {}: {error}", transition.label()));
                            false
                        }
                    },
                };
                let _ = reply.try_send(success);
            }
        }
    }

    fn set(&mut self, changes: &[(String, ParameterValue)]) -> Result<(), String> {
        let (values, made) = self.kit.parameter_store().propose(changes).map_err(|e| e.to_string())?;
        let parameters = S::Parameters::from_map(&values).map_err(|e| e.to_string())?;
        if let Some(shell) = &mut self.shell {
            shell.parameters_changed(&mut self.kit, &parameters)?;
        }
        self.kit.parameter_store().commit(values);
        self.kit.announce(&made);
        if made.iter().any(|c| c.name == "use_sim_time") {
            self.kit.follow_use_sim_time().map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    fn change(&mut self, transition: Transition) -> Result<(), NodeError> {
        let (start, goal) = transition.ends();
        let outcome = match transition {
            Transition::Configure => self.configure(),
            Transition::Activate => {
                self.kit.set_active(true);
                Ok(())
            }
            Transition::Deactivate => {
                self.kit.set_active(false);
                Ok(())
            }
            Transition::Cleanup
            | Transition::UnconfiguredShutdown
            | Transition::InactiveShutdown
            | Transition::ActiveShutdown => {
                self.kit.set_active(false);
                self.clean_up();
                Ok(())
            }
        };
        let reached = if outcome.is_ok() { goal } else { start };
        self.state.set(reached);
        if outcome.is_ok() {
            let description = transition_description(transition);
            self.events.publish(TransitionEvent {
                timestamp: u64::try_from(self.kit.now().as_nanos()).unwrap_or(0),
                transition: description.transition,
                start_state: description.start_state,
                goal_state: description.goal_state,
            });
        }
        outcome
    }

    fn configure(&mut self) -> Result<(), NodeError> {
        let parameters = S::Parameters::from_map(self.kit.parameter_store().values())?;
        match S::start(&mut self.kit, parameters) {
            Ok(shell) => self.shell = Some(shell),
            Err(error) => {
                self.clean_up();
                return Err(error);
            }
        }
        for mistake in self.kit.parameter_store().left_over() {
            self.kit.log(Level::Warn, mistake.to_string());
        }
        Ok(())
    }

    /// Devices first, then the shell with its publishers, then its subscriptions, services and timers.
    fn clean_up(&mut self) {
        self.kit.end_devices();
        self.shell = None;
        self.kit.forget_shell();
    }
}

impl<S: NodeShell> Drop for Life<S> {
    fn drop(&mut self) {
        self.kit.inbox.close();
        self.clean_up();
        // The kit's fields drop the rest: subscriptions, reader thread, DDS node, in this order.
    }
}
