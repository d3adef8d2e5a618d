//! A binary's whole `main`.

use super::{error::NodeError, process::Process, shell::NodeShell};
use crate::{
    args::{ArgumentError, RosArguments},
    parameters::{
        Descriptor, ParameterSet, common_descriptors, help_table, markdown_table, yaml_file,
    },
    scheduling::{self, Scheduling},
};
use rig_model::rig::did_you_mean;
use ros_parameters::parse_value;
use std::{ffi::OsString, process::ExitCode};

/// Runs one node until SIGINT, SIGTERM or a failure. Exit status: 0 done, 1 failed (one line on
/// standard error), 2 wrong command line.
///
/// Besides `--ros-args …`, each parameter of the node can be given as `--name value`, and the rig
/// file as `--rig rig.yaml`; see [`RosArguments::over`]. A launch file passes its arguments with
/// `--name=…`: an empty value is not given.
pub fn run_node<S: NodeShell>() -> ExitCode {
    let own = S::Parameters::descriptors();
    let words: Result<Vec<_>, _> = std::env::args_os().skip(1).map(OsString::into_string).collect();
    let parsed = words
        .map_err(|word| unknown_argument(&word.to_string_lossy(), " (it is not UTF-8)"))
        .and_then(RosArguments::parse);
    let (ros, rest) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => return report::<S>(&error.into()),
    };
    if rest.iter().any(|a| a == "--help" || a == "-h") {
        return print::<S>(&help::<S>(&own));
    }
    if rest.iter().any(|a| a == "--version" || a == "-V") {
        return print::<S>(&format!("{} {}\n", S::NAME, env!("CARGO_PKG_VERSION")));
    }
    if let Some(form) = rest.iter().find_map(|a| a.strip_prefix("--print-parameters=")) {
        let mut all = own;
        all.extend(common_descriptors());
        let text = match form {
            "yaml" => yaml_file("/**", &all),
            _ => markdown_table(&all),
        };
        return print::<S>(&text);
    }
    let started = Scheduling::take(rest).map_err(NodeError::from).and_then(|(scheduling, rest)| {
        let ros = own_arguments(ros, rest, &own)?;
        scheduling.apply()?;
        run::<S>(&ros)
    });
    match started {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => report::<S>(&error),
    }
}

fn run<S: NodeShell>(ros: &RosArguments) -> Result<(), NodeError> {
    Process::from_arguments(ros)?.run(|process| process.start::<S>(ros))
}

fn unknown_argument(argument: &str, hint: &str) -> ArgumentError {
    ArgumentError::usage(format!("`{argument}` is not known{hint}"))
}

/// Adds `--name value`, `--name=value` and `--rig file` below `ros`.
fn own_arguments(
    ros: RosArguments,
    rest: Vec<String>,
    own: &[Descriptor],
) -> Result<RosArguments, ArgumentError> {
    let mut given = RosArguments::default();
    let mut rest = rest.into_iter();
    while let Some(argument) = rest.next() {
        let unknown = || {
            let names = own.iter().map(|d| d.name.as_str());
            let names = names.chain(["rig", "help", "version", "ros-args"]);
            let names = names.chain(scheduling::OPTIONS);
            unknown_argument(&argument, &did_you_mean(argument.trim_start_matches('-'), names))
        };
        let Some(option) = argument.strip_prefix("--") else { return Err(unknown()) };
        let (name, inline) = match option.split_once('=') {
            Some((name, value)) => (name, Some(value.to_owned())),
            None => (option, None),
        };
        let known = own.iter().any(|d| d.name == name);
        if !known && !matches!(name, "rig" | "params-file") {
            return Err(unknown());
        }
        let value = inline
            .or_else(|| rest.next())
            .ok_or_else(|| ArgumentError::no_value(&argument, "a value"))?;
        if known && value.is_empty() {
            continue;
        }
        if known {
            let value = parse_value(name, &value)
                .map_err(|error| ArgumentError::usage(format!("`{argument}`: {error}")))?;
            given.set(name, value);
        } else {
            given.add_file(value.into())?;
        }
    }
    Ok(ros.over(given))
}

fn help<S: NodeShell>(own: &[Descriptor]) -> String {
    let common = help_table(&common_descriptors());
    let own = help_table(own);
    let name = S::NAME;
    format!(
        "{name}: {about}\n\n\
         usage: {name} [--rig rig.yaml] [--PARAMETER VALUE]… [--ros-args …]\n       \
         {name} --print-parameters=yaml|markdown | --version\n\n\
         --ros-args takes what ROS 2 gives every node: -r from:=to, -r __node:=name,\n\
         -r __ns:=/namespace, -p parameter:=value, --params-file file.yaml,\n\
         --log-level debug|info|warn|error|fatal.\n\n\
         process:\n{process}\n\
         parameters:\n{own}\nparameters of every node:\n{common}",
        about = S::ABOUT,
        process = scheduling::HELP
    )
}

fn print<S: NodeShell>(text: &str) -> ExitCode {
    match crate::out!("{text}") {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => error.report(S::NAME),
    }
}

fn report<S: NodeShell>(error: &NodeError) -> ExitCode {
    if error.is_usage() {
        crate::errln!("{}: {error} (`{} --help` lists what it takes)", S::NAME, S::NAME);
        ExitCode::from(2)
    } else {
        crate::errln!("{}: {error}", S::NAME);
        ExitCode::FAILURE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::names::NodeName;
    use ros_parameters::{ParameterKind, ParameterValue};

    #[test]
    fn ros_args_override_what_is_given_outside() {
        let folder = tempfile::TempDir::new().unwrap();
        let [rig, other] = ["rig", "other"].map(|name| {
            let path = folder.path().join(name);
            let text = format!("/**: {{ros__parameters: {{port: {name}, source: {name}}}}}");
            std::fs::write(&path, text).unwrap();
            path.display().to_string()
        });
        let own = [Descriptor::new("port", ParameterKind::String, None, "")];
        let node = NodeName::new("/", "imu_driver").unwrap();
        for (line, port, source) in [
            ("--port A --rig RIG --ros-args -p port:=B", "B", "rig"),
            ("--rig RIG --ros-args --params-file OTHER", "other", "other"),
            // Its own value is above every file, the last one counts, and an empty one does not:
            // launch files pass `--port=$(var port)`.
            ("--port A --port C --rig RIG --ros-args --params-file OTHER", "C", "other"),
            ("--port=A --ros-args --params-file OTHER", "A", "other"),
            ("--port= --ros-args --params-file OTHER", "other", "other"),
            // It gives way to a `-p` for the node.
            ("--port A --ros-args -p other:port:=B --params-file OTHER", "A", "other"),
            ("--port A --ros-args --params-file OTHER -p imu_driver:port:=B", "B", "other"),
            // As in rcl, the later one of the command line wins.
            ("--port A --ros-args -p port:=B --params-file OTHER", "other", "other"),
        ] {
            let line = line.replace("RIG", &rig).replace("OTHER", &other);
            let words = line.split(' ').map(str::to_owned);
            let (ros, rest) = RosArguments::parse(words).unwrap();
            let given = own_arguments(ros, rest, &own).unwrap().overrides(&node);
            let text = |text: &str| ParameterValue::String(text.to_owned());
            assert_eq!(
                (&given["port"].value, &given["source"].value),
                (&text(port), &text(source)),
                "{line}"
            );
        }
    }
}
