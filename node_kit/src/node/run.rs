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
/// Besides `--ros-args …`, each parameter of the node can be given as `--name value`, and
/// `--rig rig.yaml` stands for `--ros-args --params-file rig.yaml`. A launch file passes its
/// arguments with `--name=…`: an empty value is not given.
pub fn run_node<S: NodeShell>() -> ExitCode {
    let own = S::Parameters::descriptors();
    let words: Result<Vec<_>, _> = std::env::args_os().skip(1).map(OsString::into_string).collect();
    let parsed = words
        .map_err(|word| ArgumentError::UnknownArgument {
            argument: word.to_string_lossy().into_owned(),
            hint: " (it is not UTF-8)".to_owned(),
        })
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
    let process = Process::from_arguments(ros)?;
    process.stop_on_signals()?;
    process.run(|process| process.start::<S>(ros))
}

/// Adds `--name value`, `--name=value` and `--rig file` to `ros`.
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
                own.iter()
                    .map(|d| d.name.as_str())
                    .chain(["rig", "help", "version", "ros-args"])
                    .chain(scheduling::OPTIONS),
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
        let value = inline.or_else(|| rest.next()).ok_or_else(|| ArgumentError::MissingValue {
            option: argument.clone(),
            expected: "a value",
        })?;
        if known && value.is_empty() {
            continue;
        }
        if known {
            let value = parse_value(name, &value).map_err(|source| {
                ArgumentError::ParameterValue { text: argument.clone(), source }
            })?;
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

    /// Launch files pass `--port=$(var port)`, whose default is empty.
    #[test]
    fn an_argument_overrides_the_file_only_where_it_is_given() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("rig.yaml");
        std::fs::write(&file, "/imu_driver: {ros__parameters: {port: /dev/imu}}").unwrap();
        let own = [Descriptor::new("port", ParameterKind::String, None, "")];
        let node = NodeName::new("/", "imu_driver").unwrap();
        let port = |argument: &str| {
            let mut ros = RosArguments::default();
            ros.add_file(file.clone()).unwrap();
            own_arguments(ros, vec![argument.to_owned()], &own).unwrap().values(&node)["port"]
                .clone()
        };
        assert_eq!(port("--port="), ParameterValue::String("/dev/imu".into()));
        assert_eq!(port("--port=/dev/ttyUSB1"), ParameterValue::String("/dev/ttyUSB1".into()));
    }
}
