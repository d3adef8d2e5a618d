//! A binary's whole `main`.

use super::{NodeError, NodeShell, Process};
use crate::{
    args::{ArgumentError, RosArguments},
    parameters::{Descriptor, ParameterSet, common_descriptors, help_table, markdown_table, yaml_file},
};
use rig_model::{parameters::parse_value, rig::did_you_mean};
use std::{io::Write, process::ExitCode};

/// Runs one node until SIGINT, SIGTERM or a failure. Exit status 0 done, 1 failed (with one line), 2 wrong command line.
///
/// Besides `--ros-args …`, each parameter of the node can be given as `--name value`, and `--rig rig.yaml` stands for
/// `--ros-args --params-file rig.yaml`.
pub fn run_node<S: NodeShell>() -> ExitCode {
    run_node_with::<S>(std::env::args().skip(1))
}

/// [`run_node`] with a command line (without the program's name).
pub fn run_node_with<S: NodeShell>(arguments: impl IntoIterator<Item = String>) -> ExitCode {
    let own = S::Parameters::descriptors();
    let (ros, rest) = match RosArguments::parse(arguments) {
        Ok(parsed) => parsed,
        Err(error) => return report::<S>(&error.into()),
    };
    if rest.iter().any(|a| a == "--help" || a == "-h") {
        let _ = write!(std::io::stdout(), "{}", help::<S>(&own));
        return ExitCode::SUCCESS;
    }
    if let Some(form) = rest.iter().find_map(|a| a.strip_prefix("--print-parameters=")) {
        let mut all = own;
        all.extend(common_descriptors());
        let text = match form {
            "yaml" => yaml_file("/**", &all),
            _ => markdown_table(&all),
        };
        let _ = write!(std::io::stdout(), "{text}");
        return ExitCode::SUCCESS;
    }
    match own_arguments(ros, rest, &own).map_err(NodeError::from).and_then(|ros| run::<S>(&ros)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => report::<S>(&error),
    }
}

fn run<S: NodeShell>(ros: &RosArguments) -> Result<(), NodeError> {
    let process = Process::from_arguments(ros)?;
    process.stop_on_signals()?;
    process.run(|process| process.start::<S>(ros))
}

/// `--name value`, `--name=value` and `--rig file` as if they stood in `--ros-args`.
fn own_arguments(
    mut ros: RosArguments,
    rest: Vec<String>,
    own: &[Descriptor],
) -> Result<RosArguments, ArgumentError> {
    let mut rest = rest.into_iter();
    while let Some(argument) = rest.next() {
        let unknown = || ArgumentError::UnknownArgument {
            argument: argument.clone(),
            hint: did_you_mean(
                argument.trim_start_matches('-'),
                own.iter().map(|d| d.name.as_str()).chain(["rig", "help", "ros-args"]),
            ),
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
            .ok_or_else(|| ArgumentError::MissingValue { option: argument.clone(), expected: "a value" })?;
        if known {
            let value = parse_value(name, &value)
                .map_err(|source| ArgumentError::ParameterValue { text: argument.clone(), source })?;
            ros.set(name, value);
        } else {
            ros.add_file(value.into())?;
        }
    }
    Ok(ros)
}

fn help<S: NodeShell>(own: &[Descriptor]) -> String {
    let common = help_table(&common_descriptors());
    let own = help_table(own);
    let name = S::NAME;
    format!(
        "{name}: {about}\n\nusage: {name} [--rig rig.yaml] [--PARAMETER VALUE]… [--ros-args …]\n       \
         {name} --print-parameters=yaml|markdown\n\n\
         --ros-args takes what ROS 2 gives every node: -r from:=to, -r __node:=name, -r __ns:=/namespace,\n\
         -p parameter:=value, --params-file file.yaml, --log-level debug|info|warn|error|fatal.\n\n\
         parameters:\n{own}\nparameters of every node:\n{common}",
        about = S::ABOUT
    )
}

fn report<S: NodeShell>(error: &NodeError) -> ExitCode {
    let mut out = std::io::stderr();
    if error.is_usage() {
        let _ = writeln!(out, "{}: {error} (`{} --help` lists what it takes)", S::NAME, S::NAME);
        ExitCode::from(2)
    } else {
        let _ = writeln!(out, "{}: {error}", S::NAME);
        ExitCode::FAILURE
    }
}
