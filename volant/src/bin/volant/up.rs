//! `volant up`: any set of nodes in one process, with intra-process transport.

use crate::terminal;
use climber_driver::node::ClimberNode;
use imu_driver::node::ImuNode;
use marker_tracker::node::MarkerTrackerNode;
use node_kit::{
    ParameterSet, RosArguments,
    node::{NodeError, NodeShell, Process},
    out,
    scheduling::{self, Scheduling},
};
use pose_fusion::node::FusionNode;
use std::process::ExitCode;
use volant::command_line::failure;

const HELP: &str = "\
volant up: runs nodes in one process; images and samples are passed between them without a copy,
and topics are published for other processes

usage: volant up [NODE…] [--rig rig.yaml] [--params-file file.yaml]
                 [--foxglove[=ADDRESS:PORT]] [--realtime-priority N] [--cpus LIST]
                 [--lock-memory] [--ros-args …]

nodes (default: all four): marker_tracker, imu_driver, climber_driver, pose_fusion

--foxglove serves all live topics to Foxglove (port 8765; see `volant foxglove --help`).

--ros-args accepts what ROS 2 gives every node. -p NODE:parameter:=value and -r NODE:from:=to apply
to one node, -p parameter:=value to all nodes with that parameter.
";

#[derive(Clone, Copy)]
struct Node {
    name: &'static str,
    start: fn(&mut Process, &RosArguments) -> Result<(), NodeError>,
    parameters: fn() -> Vec<String>,
}

fn node<S: NodeShell>() -> Node {
    Node {
        name: S::NAME,
        start: |process, ros| process.start::<S>(ros),
        parameters: || S::Parameters::descriptors().into_iter().map(|d| d.name).collect(),
    }
}

fn known() -> [Node; 4] {
    [node::<MarkerTrackerNode>(), node::<ImuNode>(), node::<ClimberNode>(), node::<FusionNode>()]
}

/// The names of all parameters of all nodes.
pub fn parameters() -> Vec<String> {
    known().iter().flat_map(|n| (n.parameters)()).collect()
}

pub fn run(words: Vec<String>) -> ExitCode {
    match up(words) {
        Ok(()) => ExitCode::SUCCESS,
        Err(status) => status,
    }
}

/// Runs the nodes; an error is reported, and its exit status returned.
fn up(words: Vec<String>) -> Result<(), ExitCode> {
    let known = known();
    let wrong = |text: String| {
        terminal::line(&format!("volant up: {text} (`volant up --help` lists the options)"));
        ExitCode::from(2)
    };
    let (ros, rest) = RosArguments::parse(words).map_err(|error| wrong(error.to_string()))?;
    let (scheduling, rest) = Scheduling::take(rest).map_err(|error| wrong(error.to_string()))?;
    let mut files = RosArguments::default();
    let mut chosen: Vec<Node> = vec![];
    let mut foxglove: Option<String> = None;
    let mut rest = rest.into_iter();
    while let Some(word) = rest.next() {
        let (option, value) = match word.split_once('=') {
            Some((option, value)) => (option, Some(value.to_owned())),
            None => (word.as_str(), None),
        };
        match option {
            "--help" | "-h" if value.is_none() => {
                return out!("{HELP}\nprocess:\n{}", scheduling::HELP)
                    .map_err(|error| error.report("volant up"));
            }
            "--rig" | "--params-file" => {
                let path = value.or_else(|| rest.next());
                let path = path.ok_or_else(|| wrong(format!("{word} needs a file")))?;
                files.add_file(path.into()).map_err(|error| failed(&error.into()))?;
            }
            "--foxglove" => foxglove = Some(value.unwrap_or_default()),
            _ => match known.iter().find(|n| n.name == word) {
                Some(node) if !chosen.iter().any(|n| n.name == node.name) => chosen.push(*node),
                Some(_) => return Err(wrong(format!("`{word}` is given twice"))),
                None => return Err(wrong(format!("there is no node `{word}`"))),
            },
        }
    }
    if chosen.is_empty() {
        chosen = known.to_vec();
    }
    let mut ros = ros.over(files);
    ros.allow_of_others(chosen.iter().flat_map(|n| (n.parameters)()));
    // It handles signals before anything joins the domain.
    let process = scheduling.apply().and_then(|()| Process::from_arguments(&ros));
    let process = process.map_err(|error| failed(&error))?;
    // Kept until the nodes have ended.
    let _foxglove = foxglove
        .map(|address| crate::foxglove::start(Some(&address)))
        .transpose()
        .map_err(|error| failure("volant up", &error))?;
    let start =
        |process: &mut Process| chosen.iter().try_for_each(|node| (node.start)(process, &ros));
    process.run(start).map_err(|error| failed(&error))
}

fn failed(error: &NodeError) -> ExitCode {
    terminal::line(&format!("volant up: {error}"));
    if error.is_usage() { ExitCode::from(2) } else { ExitCode::FAILURE }
}
