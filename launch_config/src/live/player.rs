//! What steers a player from outside: [`PlayControl`], and rosbag2's services over it, on a node named as rosbag2's.

use node_kit::{
    RosArguments,
    node::{Kit, NodeError, NodeShell, Process, Responder},
};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use volant_msgs::rosbag2_interfaces::srv::{
    Burst, BurstResponse, GetRate, GetRateResponse, IsPaused, IsPausedResponse, Pause, PauseResponse,
    PlayNext, PlayNextResponse, Resume, ResumeResponse, Seek, SeekResponse, SetRate, SetRateResponse, Stop,
    StopResponse, TogglePaused, TogglePausedResponse,
};

/// Asked from outside while it plays, from any thread.
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
    /// Messages to play though paused, and all that were played so.
    burst: u64,
    burst_done: u64,
    /// Where to go on, ns of the bag, and what there is.
    seek: Option<u64>,
    span: Option<(u64, u64)>,
    ended: bool,
}

/// What the player is to do now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wish {
    pub stop: bool,
    pub paused: bool,
    pub rate: f64,
    /// One message may pass though it is paused.
    pub one: bool,
    /// It is to go on elsewhere.
    pub elsewhere: bool,
}

impl PlayControl {
    /// Plays at this rate, or waits.
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

    /// Ends it.
    pub fn stop(&self) {
        self.change(|s| s.stop = true);
    }

    /// Is it to end?
    pub fn is_stopped(&self) -> bool {
        self.lock().stop
    }

    /// Holds it, or has it go on.
    pub fn set_paused(&self, paused: bool) {
        self.change(|s| s.paused = paused);
    }

    /// The one or the other.
    pub fn toggle_paused(&self) {
        self.change(|s| s.paused = !s.paused);
    }

    /// Is it held?
    pub fn is_paused(&self) -> bool {
        self.lock().paused
    }

    /// How fast: 2 is twice as fast as it was recorded.
    pub fn rate(&self) -> f64 {
        self.lock().rate
    }

    /// Plays at another rate from now on; false for one that cannot be.
    pub fn set_rate(&self, rate: f64) -> bool {
        let possible = rate.is_finite() && rate > 0.0;
        if possible {
            self.change(|s| s.rate = rate);
        }
        possible
    }

    /// Plays so many messages while it is paused, at once; 0: all that are left. Returns when they are out, with how many there
    /// were: none where it is not paused.
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

    /// Goes on at a time of the bag, ns; false where the bag does not reach.
    pub fn seek(&self, time: u64) -> bool {
        self.change(|s| {
            let possible = !s.ended && s.span.is_some_and(|(first, last)| (first..=last).contains(&time));
            if possible {
                s.seek = Some(time);
            }
            possible
        })
    }

    pub(super) fn wish(&self) -> Wish {
        let s = self.lock();
        Wish { stop: s.stop, paused: s.paused, rate: s.rate, one: s.burst > 0, elsewhere: s.seek.is_some() }
    }

    pub(super) fn begin(&self, span: (u64, u64)) {
        self.change(|s| s.span = Some(span));
    }

    /// A message of a burst is out.
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

/// One request.
pub enum Ask {
    /// Hold it.
    Pause(Responder<Pause>),
    /// Go on.
    Resume(Responder<Resume>),
    /// The one or the other.
    Toggle(Responder<TogglePaused>),
    /// Is it held?
    IsPaused(Responder<IsPaused>),
    /// How fast?
    GetRate(Responder<GetRate>),
    /// So fast.
    SetRate(f64, Responder<SetRate>),
    /// One message.
    Next(Responder<PlayNext>),
    /// So many.
    Burst(u64, Responder<Burst>),
    /// From there.
    Seek(Option<u64>, Responder<Seek>),
    /// End.
    Stop(Responder<Stop>),
}

/// A node's shell is started by its type alone, so what it steers waits here for it.
static CONTROL: Mutex<Option<Arc<PlayControl>>> = Mutex::new(None);

struct Player(Arc<PlayControl>);

impl NodeShell for Player {
    const NAME: &'static str = "rosbag2_player";
    const ABOUT: &'static str = "a bag onto live topics";
    type Parameters = ();
    type Input = Ask;

    fn start(kit: &mut Kit<Ask>, (): ()) -> Result<Self, NodeError> {
        let waiting = CONTROL.lock().unwrap_or_else(PoisonError::into_inner).take();
        let control =
            waiting.ok_or_else(|| NodeError::shell("the player's node is started by the player alone"))?;
        kit.serve::<Pause>("~/pause", |_, answer| Ask::Pause(answer))?;
        kit.serve::<Resume>("~/resume", |_, answer| Ask::Resume(answer))?;
        kit.serve::<TogglePaused>("~/toggle_paused", |_, answer| Ask::Toggle(answer))?;
        kit.serve::<IsPaused>("~/is_paused", |_, answer| Ask::IsPaused(answer))?;
        kit.serve::<GetRate>("~/get_rate", |_, answer| Ask::GetRate(answer))?;
        kit.serve::<SetRate>("~/set_rate", |ask, answer| Ask::SetRate(ask.rate, answer))?;
        kit.serve::<PlayNext>("~/play_next", |_, answer| Ask::Next(answer))?;
        kit.serve::<Burst>("~/burst", |ask, answer| Ask::Burst(ask.num_messages, answer))?;
        kit.serve::<Seek>("~/seek", |ask, answer| {
            let seconds = u64::try_from(ask.time.sec).ok();
            Ask::Seek(seconds.map(|s| s * 1_000_000_000 + u64::from(ask.time.nanosec)), answer)
        })?;
        kit.serve::<Stop>("~/stop", |_, answer| Ask::Stop(answer))?;
        Ok(Self(control))
    }

    fn handle(&mut self, _: &mut Kit<Ask>, ask: Ask) {
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
            Ask::IsPaused(answer) => answer.respond(IsPausedResponse { paused: control.is_paused() }),
            Ask::GetRate(answer) => answer.respond(GetRateResponse { rate: control.rate() }),
            Ask::SetRate(rate, answer) => answer.respond(SetRateResponse { success: control.set_rate(rate) }),
            Ask::Next(answer) => answer.respond(PlayNextResponse { success: control.burst(1) == 1 }),
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

/// Starts the node `rosbag2_player` with rosbag2's services over `control`; it leaves when what is returned drops.
///
/// # Errors
/// DDS's refusal, or a variable of the environment that cannot be.
pub fn serve(control: &Arc<PlayControl>) -> Result<Process, NodeError> {
    let mut process = Process::from_environment()?;
    *CONTROL.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(control));
    process.start::<Player>(&RosArguments::default())?;
    Ok(process)
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
    fn what_cannot_be_is_refused() {
        let control = PlayControl::new(1.0, true);
        assert!(!control.seek(15), "nothing is known of the bag");
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
