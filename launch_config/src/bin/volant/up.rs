//! `volant up`: any set of nodes in one process, with hand-over inside of it.

use crate::say;
use climber_driver::node::ClimberNode;
use imu_driver::node::ImuNode;
use marker_tracker::node::MarkerTrackerNode;
use node_kit::{
    ParameterSet, RosArguments,
    node::{NodeError, NodeShell, Process},
};
use pose_fusion::node::FusionNode;
use std::{ffi::OsString, process::ExitCode};

const HELP: &str =
    "volant up: nodes in one process; images and samples pass without a copy, topics stay there for others

usage: volant up [NODE…] [--rig rig.yaml] [--params-file file.yaml] [--foxglove[=ADDRESS:PORT]] [--ros-args …]

nodes (all four without a name): marker_tracker, imu_driver, climber_driver, pose_fusion

--foxglove serves all live topics to Foxglove (port 8765; see `volant foxglove --help`).

--ros-args takes what ROS 2 gives every node; -p NODE:parameter:=value and -r NODE:from:=to mean one of them, and
-p parameter:=value all that have it.
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

pub fn run(words: &[OsString]) -> ExitCode {
    let known = known();
    let wrong = |text: String| {
        say::line(&format!("volant up: {text} (`volant up --help` lists what it takes)"));
        ExitCode::from(2)
    };
    let words = words.iter().map(|w| w.to_string_lossy().into_owned());
    let (mut ros, rest) = match RosArguments::parse(words) {
        Ok(parsed) => parsed,
        Err(error) => return wrong(error.to_string()),
    };
    let mut chosen: Vec<Node> = vec![];
    let mut foxglove: Option<String> = None;
    let mut rest = rest.into_iter();
    while let Some(word) = rest.next() {
        match word.as_str() {
            "--help" | "-h" => {
                print!("{HELP}");
                return ExitCode::SUCCESS;
            }
            "--rig" | "--params-file" => {
                let Some(path) = rest.next() else { return wrong(format!("{word} takes a file")) };
                if let Err(error) = ros.add_file(path.into()) {
                    say::line(&format!("volant up: {error}"));
                    return if error.is_usage() { ExitCode::from(2) } else { ExitCode::FAILURE };
                }
            }
            "--foxglove" => foxglove = Some(String::new()),
            word if word.starts_with("--foxglove=") => {
                foxglove = word.split_once('=').map(|(_, address)| address.to_owned());
            }
            name => match known.iter().find(|n| n.name == name) {
                Some(node) if !chosen.iter().any(|n| n.name == node.name) => chosen.push(*node),
                Some(_) => return wrong(format!("`{name}` is there twice")),
                None => return wrong(format!("`{name}` is no node of this program")),
            },
        }
    }
    if chosen.is_empty() {
        chosen = known.to_vec();
    }
    ros.allow_of_others(chosen.iter().flat_map(|n| (n.parameters)()));
    // Kept until the nodes have ended.
    let _foxglove = match foxglove.map(|address| crate::foxglove::start(Some(&address))).transpose() {
        Ok(server) => server,
        Err(error) => {
            say::line(&format!("volant up: {error:#}"));
            return ExitCode::FAILURE;
        }
    };
    match up(&chosen, &ros) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say::line(&format!("volant up: {error}"));
            if error.is_usage() { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

fn up(nodes: &[Node], ros: &RosArguments) -> Result<(), NodeError> {
    let process = Process::from_arguments(ros)?;
    process.stop_on_signals()?;
    process.run(|process| nodes.iter().try_for_each(|node| (node.start)(process, ros)))
}
