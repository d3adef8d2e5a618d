//! `volant play`.

use crate::{say, signals};
use launch_config::{
    live::play::{PlayControl, PlayOptions, play, serve},
    replay::TopicNames,
};
use std::{io::Read, path::PathBuf, sync::Arc, time::Duration};

#[derive(clap::Args)]
pub struct Arguments {
    /// The bag: an .mcap file or a rosbag2 folder
    input: PathBuf,
    /// How fast: 2 is twice as fast as it was recorded
    #[arg(short, long, default_value_t = 1.0, value_parser = positive)]
    rate: f64,
    /// Again from its beginning at its end
    #[arg(short = 'l', long = "loop")]
    repeat: bool,
    /// Seconds to leave out of the beginning
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    start_offset: f64,
    /// Seconds to wait at first, for subscribers to find the topics
    #[arg(short, long, value_name = "SECONDS", default_value_t = 0.5)]
    delay: f64,
    /// Starts paused; the space bar goes on and pauses again, and so do SIGUSR1 and rosbag2's services on /rosbag2_player
    #[arg(short, long)]
    paused: bool,
    /// Publishes /clock, so many times a second
    #[arg(long, value_name = "HZ", num_args = 0..=1, default_missing_value = "40", value_parser = positive)]
    clock: Option<f64>,
    /// Only these topics
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    topics: Vec<String>,
    /// Another name of a topic, as from:=to; may be given several times
    #[arg(short = 'm', long, value_name = "FROM:=TO", num_args = 1..)]
    remap: Vec<String>,
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x: &f64| x.is_finite() && *x > 0.0).ok_or("it must be a number above 0".into())
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let seconds = |s: f64| Duration::try_from_secs_f64(s.max(0.0)).unwrap_or(Duration::MAX);
    let absolute = |name: &String| if name.starts_with('/') { name.clone() } else { format!("/{name}") };
    let options = PlayOptions {
        input: arguments.input.clone(),
        repeat: arguments.repeat,
        start_offset: seconds(arguments.start_offset),
        delay: seconds(arguments.delay),
        clock_hz: arguments.clock,
        topics: arguments.topics.iter().map(absolute).collect(),
        names: TopicNames::new("", &arguments.remap)?,
    };
    let control = Arc::new(PlayControl::new(arguments.rate, arguments.paused));
    let services = serve(&control)?;
    signals::on_stop({
        let control = control.clone();
        move || control.stop()
    })?;
    signals::on_usr1({
        let control = control.clone();
        move || control.toggle_paused()
    })?;
    let keys = Keys::listen(&control);
    let bar = say::spinner();
    let result = play(&options, &control, |time, (first, last)| {
        let at = |t: u64| t.saturating_sub(first) as f64 * 1e-9;
        let hint = if keys.is_some() { "; space pauses" } else { "" };
        bar.set_message(format!("playing {:.1} of {:.1} s{hint}", at(time), at(last)));
    });
    bar.finish_and_clear();
    drop((keys, services));
    let report = result?;
    for loss in &report.losses {
        say::line(&format!("volant: {loss}"));
    }
    if report.refused > 0 {
        say::line(&format!(
            "volant: {} messages were not published: a reliable subscriber did not keep up, or they are no little-endian CDR",
            report.refused
        ));
    }
    println!("{} messages of {}", report.messages, arguments.input.display());
    Ok(())
}

/// The space bar, on a terminal that gives keys one by one while this lives.
struct Keys(rustix::termios::Termios);

impl Keys {
    fn listen(control: &Arc<PlayControl>) -> Option<Self> {
        use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
        let stdin = std::io::stdin();
        let before = tcgetattr(&stdin).ok()?;
        let mut keys = before.clone();
        keys.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        tcsetattr(&stdin, OptionalActions::Now, &keys).ok()?;
        let control = control.clone();
        // Ends with the program: a read cannot be called off.
        std::thread::spawn(move || {
            for key in std::io::stdin().lock().bytes().map_while(Result::ok) {
                if key == b' ' {
                    control.toggle_paused();
                }
            }
        });
        Some(Self(before))
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        let _ = rustix::termios::tcsetattr(std::io::stdin(), rustix::termios::OptionalActions::Now, &self.0);
    }
}
