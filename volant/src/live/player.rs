//! Controls of a player: [`PlayControl`], and rosbag2's services over it, on a node with rosbag2's
//! name.

use super::LiveError;
use node_kit::{
    RosArguments,
    node::{NodeContext, NodeError, NodeHandle, NodeShell, Process},
};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, mpsc::sync_channel};
use volant_msgs::{
    Service,
    rosbag2_interfaces::srv::{
        Burst, BurstResponse, GetRate, GetRateResponse, IsPaused, IsPausedResponse, Pause,
        PauseResponse, PlayNext, PlayNextResponse, Resume, ResumeResponse, Seek, SeekResponse,
        SetRate, SetRateResponse, Stop, StopResponse, TogglePaused, TogglePausedResponse,
    },
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

/// Replies to a request of a service, on the node's thread.
type Reply = Box<dyn FnOnce(&PlayControl) + Send>;

/// Offers a service; `answer` returns the response to a request.
fn serve<S: Service>(
    context: &mut NodeContext<Reply>,
    name: &str,
    answer: fn(&PlayControl, S::Request) -> S::Response,
) -> Result<(), NodeError> {
    context.serve::<S>(name, move |request, responder| -> Reply {
        Box::new(move |control: &PlayControl| responder.respond(answer(control, request)))
    })
}

struct Player(Arc<PlayControl>);

impl Player {
    /// Offers rosbag2's services over `control`.
    fn offer(
        context: &mut NodeContext<Reply>,
        control: Arc<PlayControl>,
    ) -> Result<Self, NodeError> {
        serve::<Pause>(context, "~/pause", |control, _| {
            control.set_paused(true);
            PauseResponse::default()
        })?;
        serve::<Resume>(context, "~/resume", |control, _| {
            control.set_paused(false);
            ResumeResponse::default()
        })?;
        serve::<TogglePaused>(context, "~/toggle_paused", |control, _| {
            control.toggle_paused();
            TogglePausedResponse::default()
        })?;
        serve::<IsPaused>(context, "~/is_paused", |control, _| IsPausedResponse {
            paused: control.is_paused(),
        })?;
        serve::<GetRate>(context, "~/get_rate", |control, _| GetRateResponse {
            rate: control.rate(),
        })?;
        serve::<SetRate>(context, "~/set_rate", |control, request| SetRateResponse {
            success: control.set_rate(request.rate),
        })?;
        serve::<PlayNext>(context, "~/play_next", |control, _| PlayNextResponse {
            success: control.burst(1) == 1,
        })?;
        serve::<Burst>(context, "~/burst", |control, request| BurstResponse {
            actually_burst: control.burst(request.num_messages),
        })?;
        serve::<Seek>(context, "~/seek", |control, request| {
            let seconds = u64::try_from(request.time.sec).ok();
            let nanos = |s: u64| s * 1_000_000_000 + u64::from(request.time.nanosec);
            SeekResponse { success: seconds.is_some_and(|s| control.seek(nanos(s))) }
        })?;
        serve::<Stop>(context, "~/stop", |control, _| {
            control.stop();
            StopResponse::default()
        })?;
        Ok(Self(control))
    }
}

impl NodeShell for Player {
    const NAME: &'static str = "rosbag2_player";
    const ABOUT: &'static str = "plays a bag to live topics";
    type Parameters = ();
    type Input = Reply;

    fn handle(&mut self, _: &mut NodeContext<Reply>, reply: Reply) {
        reply(&self.0);
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
