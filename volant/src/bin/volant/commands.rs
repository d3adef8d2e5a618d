//! All commands of `volant`: their list, those that are executables of their own, shell completions
//! and manual pages.

use crate::{Action, Arguments, terminal};
use clap::{Arg, Command, CommandFactory, Subcommand, ValueHint};
use node_kit::{console::EXIT_STATUS, out, outln};
use rig_model::rig::did_you_mean;
use std::{
    ffi::OsString,
    fmt::Write as _,
    os::unix::process::CommandExt,
    path::PathBuf,
    process::{self, ExitCode},
};
use volant::command_line::Manual;

/// A command that is an executable of its own, beside this one or on the path.
struct External {
    name: &'static str,
    executable: &'static str,
    about: &'static str,
}

const fn external(name: &'static str, executable: &'static str, about: &'static str) -> External {
    External { name, executable, about }
}

/// The simulated rig's executable.
const RIG: &str = "volant-rig";

/// What needs the simulated rig or all of OpenCV does not weigh on the robot.
const EXTERNAL: [External; 11] = [
    external("imu", "volant-imu", "Find, inspect, configure and log Xsens IMUs; decode logs"),
    external(
        "calibrate",
        "volant-calibrate",
        "Calibrate camera, colors, mountings, encoders and IMU",
    ),
    external("demo", RIG, "Run the four nodes live on the simulated rig"),
    external("faults", RIG, "Inject faults into a live simulated rig"),
    external("checks", RIG, "Test `check` on recordings with wrong files"),
    external("hosts", RIG, "Run the rig on two computers with a bad link (as root)"),
    external("robustness", RIG, "Replay recordings with wrong rig files"),
    external("simulate", RIG, "Write simulated recordings with ground truth"),
    external("sites", RIG, "Run rigs and an operator on two sites with bridges (as root)"),
    external("soak", RIG, "Run the rig for hours with faults at random"),
    external("reproduce", RIG, "Reproduce the paper's figures and tables"),
];

/// Groups of the list; those of the simulated rig and the rest follow.
const GROUPS: [(&str, &[&str]); 3] = [
    ("On the rig", &["up", "record", "play", "monitor", "foxglove", "imu"]),
    ("Set up and check", &["bringup", "markers", "calibrate", "check"]),
    ("Recordings", &["replay", "evaluate", "bag"]),
];

/// The list of all commands, by group, and the exit status: the end of `volant --help`.
pub fn listing() -> String {
    let own = Action::augment_subcommands(Command::new("volant"));
    let about = |name: &str| {
        let external = || EXTERNAL.iter().find(|e| e.name == name).map(|e| e.about.to_owned());
        let about = own.find_subcommand(name).and_then(Command::get_about);
        let about = about.map(ToString::to_string).or_else(external);
        about.unwrap_or_else(|| "Print the help of a command".to_owned())
    };
    let grouped = |name: &&str| GROUPS.iter().any(|(_, names)| names.contains(name));
    let simulated = EXTERNAL.iter().filter(|e| e.executable == RIG).map(|e| e.name);
    let simulated: Vec<&str> = simulated.collect();
    let rest = own.get_subcommands().map(Command::get_name).filter(|name| !grouped(name));
    let rest: Vec<&str> = rest.chain(["help"]).collect();
    let more = [("Simulated rig", simulated.as_slice()), ("This command", rest.as_slice())];
    let mut text = String::new();
    for (title, names) in GROUPS.into_iter().chain(more) {
        let rows = names.iter().map(|name| format!("  {name:<12} {}\n", about(name)));
        let _ = write!(text, "\n{title}:\n{}", rows.collect::<String>());
    }
    format!("{}\n{EXIT_STATUS}", text.trim_start())
}

/// Runs `volant X …` as an executable `volant-X` or as that of [`EXTERNAL`], which takes the place
/// of this process; `volant help X` as `volant X --help`.
pub fn other(words: &[OsString]) -> ExitCode {
    let Some((first, rest)) = words.split_first() else {
        return ExitCode::from(2);
    };
    let name = first.to_string_lossy();
    if name == "help" {
        let own = std::env::current_exe().unwrap_or_else(|_| "volant".into());
        return become_(process::Command::new(own).args(rest).arg("--help"), "volant", "");
    }
    let known = EXTERNAL.iter().find(|e| e.name == name);
    let executable = known.map_or_else(|| format!("volant-{name}"), |e| e.executable.to_owned());
    let missing = match (known, executable.as_str()) {
        (None, _) => {
            let own = Action::augment_subcommands(Command::new("volant"));
            let own = own.get_subcommands().map(Command::get_name);
            let others = EXTERNAL.iter().map(|e| e.name).chain(["help"]);
            let hint = did_you_mean(&name, own.chain(others));
            format!(
                "unknown command `{name}`{hint}, and no executable `{executable}`; see volant --help"
            )
        }
        (_, "volant-calibrate") => {
            format!("`{name}` needs {executable}; build it with `make calibrate`")
        }
        _ => format!(
            "`{name}` needs {executable}; the Debian package has it, and `cargo build --release \
             --workspace --bins` builds it"
        ),
    };
    let mut command =
        process::Command::new(beside(&executable).unwrap_or_else(|| executable.clone().into()));
    // It has several commands.
    command.args(if executable == RIG { words } else { rest });
    let status = become_(&mut command, &executable, &missing);
    if known.is_none() { ExitCode::from(2) } else { status }
}

/// An executable in the folder of this one.
fn beside(name: &str) -> Option<PathBuf> {
    let own = std::env::current_exe().ok()?;
    Some(own.parent()?.join(name)).filter(|path| path.is_file())
}

/// Replaces this process, so that signals and the exit status are the other one's; returns where
/// that fails.
fn become_(command: &mut process::Command, name: &str, missing: &str) -> ExitCode {
    let error = command.exec();
    if error.kind() == std::io::ErrorKind::NotFound {
        terminal::warn(missing);
    } else {
        terminal::warn(format!("{name} cannot be run: {error}"));
    }
    ExitCode::FAILURE
}

/// The command line with the commands of the other executables: `volant-imu` with all its options,
/// the rest with their names.
fn whole() -> Command {
    let mut whole = Arguments::command();
    whole = whole.subcommand(crate::calibrate::Arguments::command().name("calibrate"));
    whole = whole.subcommand(imu_driver::tool::Arguments::command().name("imu"));
    for external in EXTERNAL {
        if whole.find_subcommand(external.name).is_none() {
            let words = Arg::new("words").num_args(0..).value_hint(ValueHint::AnyPath);
            whole = whole.subcommand(Command::new(external.name).about(external.about).arg(words));
        }
    }
    whole
}

/// Prints completions.
pub fn completions(shell: clap_complete::Shell) -> anyhow::Result<()> {
    let mut text = vec![];
    clap_complete::generate(shell, &mut whole(), "volant", &mut text);
    out!("{}", String::from_utf8_lossy(&text))?;
    Ok(())
}

/// Writes the manual pages; those of the simulated rig's commands are written by its executable.
pub fn manual(arguments: &Manual) -> anyhow::Result<()> {
    let mut command = whole();
    if let Some(rig) = beside(RIG) {
        for external in EXTERNAL.iter().filter(|e| e.executable == RIG) {
            command = command.mut_subcommand(external.name, |c| c.hide(true));
        }
        let overwrite = arguments.overwrite.then_some("--overwrite");
        let done = process::Command::new(rig)
            .args(["manual".as_ref(), "--out".as_ref(), arguments.out.as_os_str()])
            .args(overwrite)
            .output()?;
        // Its error names itself, and is one line.
        let error = String::from_utf8_lossy(&done.stderr);
        anyhow::ensure!(done.status.success(), "{}", error.trim_end());
    }
    arguments.write(command, true)?;
    let folder = arguments.out.display();
    outln!("the pages are in {folder}; `man -l {folder}/volant.1` shows the first")?;
    Ok(())
}
