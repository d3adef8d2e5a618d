//! Controls of a player: [`PlayControl`], and rosbag2's services over it, on a node with rosbag2's
//! name.

use super::LiveError;
use node_kit::{
    RosArguments,
    node::{NodeContext, NodeError, NodeHandle, NodeShell, Process, Responder},
};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, mpsc::sync_channel};
use volant_msgs::rosbag2_interfaces::srv::{
    Burst, BurstResponse, GetRate, GetRateResponse, IsPaused, IsPausedResponse, Pause,
    PauseResponse, PlayNext, PlayNextResponse, Resume, ResumeResponse, Seek, SeekResponse, SetRate,
    SetRateResponse, Stop, StopResponse, TogglePaused, TogglePausedResponse,
};

/// Controls of a playback, for use from any thread.
#[derive(Debug)]
pub struct PlayControl {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug)]
struct State {
    stop: bool,
    paused: bool,
    rate: f64,
    /// Remaining messages of bursts, and all that were played in bursts.
    burst: u64,
    burst_done: u64,
    /// Time to seek to, and span of the bag, ns.
    seek: Option<u64>,
    span: Option<(u64, u64)>,
    ended: bool,
}

/// Next action of the player.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wish {
    pub stop: bool,
    pub paused: bool,
    pub rate: f64,
    /// Play one message although paused.
    pub one: bool,
    /// Seek.
    pub elsewhere: bool,
}

impl PlayControl {
    /// Creates controls with a rate and a paused state.
    pub fn new(rate: f64, paused: bool) -> Self {
        let state = State {
            stop: false,
            paused,
            rate,
            burst: 0,
            burst_done: 0,
            seek: None,
            span: None,
            ended: false,
        };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let result = change(&mut self.lock());
        self.changed.notify_all();
        result
    }

    /// Stops the playback.
    pub fn stop(&self) {
        self.change(|s| s.stop = true);
    }

    /// Whether the playback is stopped.
    pub fn is_stopped(&self) -> bool {
        self.lock().stop
    }

    /// Pauses or resumes.
    pub fn set_paused(&self, paused: bool) {
        self.change(|s| s.paused = paused);
    }

    /// Toggles between paused and playing.
    pub fn toggle_paused(&self) {
        self.change(|s| s.paused = !s.paused);
    }

    /// Whether the playback is paused.
    pub fn is_paused(&self) -> bool {
        self.lock().paused
    }

    /// Playback rate; 2 is twice as fast as recorded.
    pub fn rate(&self) -> f64 {
        self.lock().rate
    }

    /// Sets the rate; returns false for an invalid one.
    pub fn set_rate(&self, rate: f64) -> bool {
        let possible = rate.is_finite() && rate > 0.0;
        if possible {
            self.change(|s| s.rate = rate);
        }
        possible
    }

    /// Plays `count` messages at once while paused (0: all remaining). Returns after the last one
    /// with their number; 0 if not paused.
    pub fn burst(&self, count: u64) -> u64 {
        let mut s = self.lock();
        if !s.paused || s.ended {
            return 0;
        }
        let count = if count == 0 { u64::MAX } else { count };
        let before = s.burst_done;
        s.burst = count;
        let goes_on = |s: &mut State| s.burst > 0 && s.paused && !s.stop && !s.ended;
        let mut s = self.changed.wait_while(s, goes_on).unwrap_or_else(PoisonError::into_inner);
        s.burst = 0;
        s.burst_done - before
    }

    /// Seeks to a time of the bag, ns; returns false outside of the bag's span.
    pub fn seek(&self, time: u64) -> bool {
        self.change(|s| {
            let possible =
                !s.ended && s.span.is_some_and(|(first, last)| (first..=last).contains(&time));
            if possible {
                s.seek = Some(time);
            }
            possible
        })
    }

    pub(super) fn wish(&self) -> Wish {
        let s = self.lock();
        Wish {
            stop: s.stop,
            paused: s.paused,
            rate: s.rate,
            one: s.burst > 0,
            elsewhere: s.seek.is_some(),
        }
    }

    pub(super) fn begin(&self, span: (u64, u64)) {
        self.change(|s| s.span = Some(span));
    }

    /// Counts a published message of a burst.
    pub(super) fn one_is_out(&self) {
        self.change(|s| {
            s.burst = s.burst.saturating_sub(1);
            s.burst_done += 1;
        });
    }

    pub(super) fn take_seek(&self) -> Option<u64> {
        self.lock().seek.take()
    }

    pub(super) fn end(&self) {
        self.change(|s| s.ended = true);
    }
}

/// Request of a service.
pub enum Ask {
    /// Pause.
    Pause(Responder<Pause>),
    /// Resume.
    Resume(Responder<Resume>),
    /// Toggles between paused and playing.
    Toggle(Responder<TogglePaused>),
    /// Whether the playback is paused.
    IsPaused(Responder<IsPaused>),
    /// Get the rate.
    GetRate(Responder<GetRate>),
    /// Set the rate.
    SetRate(f64, Responder<SetRate>),
    /// Play the next message.
    Next(Responder<PlayNext>),
    /// Play a number of messages.
    Burst(u64, Responder<Burst>),
    /// Seek.
    Seek(Option<u64>, Responder<Seek>),
    /// Stop.
    Stop(Responder<Stop>),
}

struct Player(Arc<PlayControl>);

impl Player {
    /// Offers rosbag2's services over `control`.
    fn offer(context: &mut NodeContext<Ask>, control: Arc<PlayControl>) -> Result<Self, NodeError> {
        context.serve::<Pause>("~/pause", |_, answer| Ask::Pause(answer))?;
        context.serve::<Resume>("~/resume", |_, answer| Ask::Resume(answer))?;
        context.serve::<TogglePaused>("~/toggle_paused", |_, answer| Ask::Toggle(answer))?;
        context.serve::<IsPaused>("~/is_paused", |_, answer| Ask::IsPaused(answer))?;
        context.serve::<GetRate>("~/get_rate", |_, answer| Ask::GetRate(answer))?;
        context.serve::<SetRate>("~/set_rate", |ask, answer| Ask::SetRate(ask.rate, answer))?;
        context.serve::<PlayNext>("~/play_next", |_, answer| Ask::Next(answer))?;
        context.serve::<Burst>("~/burst", |ask, answer| Ask::Burst(ask.num_messages, answer))?;
        context.serve::<Seek>("~/seek", |ask, answer| {
            let seconds = u64::try_from(ask.time.sec).ok();
            Ask::Seek(seconds.map(|s| s * 1_000_000_000 + u64::from(ask.time.nanosec)), answer)
        })?;
        context.serve::<Stop>("~/stop", |_, answer| Ask::Stop(answer))?;
        Ok(Self(control))
    }
}

impl NodeShell for Player {
    const NAME: &'static str = "rosbag2_player";
    const ABOUT: &'static str = "plays a bag to live topics";
    type Parameters = ();
    type Input = Ask;

    fn handle(&mut self, _: &mut NodeContext<Ask>, ask: Ask) {
        let control = &self.0;
        match ask {
            Ask::Pause(answer) => {
                control.set_paused(true);
                answer.respond(PauseResponse::default());
            }
            Ask::Resume(answer) => {
                control.set_paused(false);
                answer.respond(ResumeResponse::default());
            }
            Ask::Toggle(answer) => {
                control.toggle_paused();
                answer.respond(TogglePausedResponse::default());
            }
            Ask::IsPaused(answer) => {
                answer.respond(IsPausedResponse { paused: control.is_paused() })
            }
            Ask::GetRate(answer) => answer.respond(GetRateResponse { rate: control.rate() }),
            Ask::SetRate(rate, answer) => {
                answer.respond(SetRateResponse { success: control.set_rate(rate) })
            }
            Ask::Next(answer) => {
                answer.respond(PlayNextResponse { success: control.burst(1) == 1 })
            }
            Ask::Burst(count, answer) => {
                answer.respond(BurstResponse { actually_burst: control.burst(count) });
            }
            Ask::Seek(time, answer) => {
                answer.respond(SeekResponse { success: time.is_some_and(|t| control.seek(t)) });
            }
            Ask::Stop(answer) => {
                control.stop();
                answer.respond(StopResponse::default());
            }
        }
    }
}

/// Starts the node `rosbag2_player` with rosbag2's services over `control`, and with what `publish`
/// creates on it; dropping the returned process ends it.
///
/// # Errors
/// An invalid variable of the environment, DDS creates no participant or service, or the error of
/// `publish`.
pub(super) fn start<T: Send + 'static>(
    control: &Arc<PlayControl>,
    publish: impl FnOnce(&mut NodeHandle) -> Result<T, LiveError> + Send + 'static,
) -> Result<(Process, T), LiveError> {
    let mut process = Process::from_environment()?;
    let control = Arc::clone(control);
    let (made, publishers) = sync_channel(1);
    let mut publish = Some(publish);
    process.start_with(&RosArguments::default(), move |context, ()| {
        // Once: the publishers stay when the node is configured again.
        if let Some(publish) = publish.take() {
            // The receiver is there until this has returned.
            let _ = made.send(publish(context));
        }
        Player::offer(context, Arc::clone(&control))
    })?;
    let publishers =
        publishers.recv().map_err(|_| LiveError::Thread { what: "the player's node" })??;
    Ok((process, publishers))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_passes_while_it_is_paused_and_ends_with_the_bag() {
        let control = Arc::new(PlayControl::new(1.0, false));
        control.begin((10, 20));
        assert_eq!(control.burst(3), 0, "it is not paused");
        control.set_paused(true);
        let asking = std::thread::spawn({
            let control = Arc::clone(&control);
            move || (control.burst(3), control.burst(0))
        });
        let mut played = 0;
        while played < 5 {
            if control.wish().one {
                control.one_is_out();
                played += 1;
            }
            std::thread::yield_now();
        }
        control.end();
        assert_eq!(asking.join().unwrap(), (3, 2));
    }

    #[test]
    fn invalid_controls_are_rejected() {
        let control = PlayControl::new(1.0, true);
        assert!(!control.seek(15), "no span is set");
        control.begin((10, 20));
        assert!(control.seek(15) && !control.seek(21) && !control.seek(9));
        assert_eq!((control.take_seek(), control.take_seek()), (Some(15), None));
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(!control.set_rate(rate));
        }
        assert!(control.set_rate(2.0));
        assert_eq!(control.rate(), 2.0);
    }
}
