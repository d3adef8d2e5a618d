//! Nodes, peers and clients of the tests.
#![allow(dead_code, reason = "each test uses a part")]
#![allow(clippy::unwrap_used, clippy::panic, clippy::disallowed_methods, reason = "tests")]

use node_kit::{NodeContext, NodeError, Process, QosPreset, environment::Network, node::join};
use ros2_client::{
    Context, Message, Name, Node, NodeName, NodeOptions, QosProfile, ServiceMapping,
    ServiceTypeName, qos::WhenFull, service::Client,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};
use test_support::process::{Running, example, in_domain};

/// The Python that has `cyclonedds`, else a skip.
pub fn python() -> Option<PathBuf> {
    test_support::python("cyclonedds")
}

/// A ROS 2 node of another participant in this process, for clients of services.
pub fn client_node(domain: u16) -> Node {
    let network = Network { domain_id: domain, ..Network::default() };
    let (participant, _) = join(&network).unwrap();
    let context = Context::from_domain_participant(participant).unwrap();
    let options = NodeOptions::new().enable_rosout(false);
    context.new_node(NodeName::new("/", "client").unwrap(), options).unwrap()
}

/// Client of a service of `rcl_interfaces`, with the identity of a request beside the payload as
/// Fast DDS has it.
pub fn client<Request: Message + Clone + 'static, Response: Message + 'static>(
    node: &mut Node,
    service: &str,
    type_name: &str,
) -> Client<Request, Response> {
    let qos = QosProfile::publisher_default().reliability_reliable(WhenFull::Fail);
    node.create_client(
        ServiceMapping::Enhanced,
        &Name::parse(service).unwrap(),
        &ServiceTypeName::new("rcl_interfaces", type_name),
        qos.clone(),
        qos,
    )
    .unwrap()
}

/// Starts a program in a DDS domain that is not limited to this computer.
pub fn start(
    domain: u16,
    program: &Path,
    arguments: &[&str],
    environment: &[(&str, &str)],
) -> Running {
    Running::start(
        in_domain(domain, program)
            .args(arguments)
            .env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE")
            .envs(environment.iter().copied()),
    )
}

/// Starts the example `minimal_node`.
pub fn minimal(domain: u16, arguments: &[&str], environment: &[(&str, &str)]) -> Running {
    start(domain, &example("minimal_node"), arguments, environment)
}

/// Starts a command of `tests/peer.py`.
pub fn peer(domain: u16, python: &Path, arguments: &[&str]) -> Running {
    script(domain, python, "peer.py", arguments)
}

/// Starts a script of `tests` with Python.
pub fn script(domain: u16, python: &Path, name: &str, arguments: &[&str]) -> Running {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests").join(name);
    let mut all = vec![path.to_str().unwrap()];
    all.extend(arguments);
    start(domain, python, &all, &[])
}

/// The number of a key in a line of JSON.
pub fn number(line: &str, key: &str) -> f64 {
    let rest = line.split(&format!("\"{key}\": ")).nth(1).unwrap();
    rest.split([',', '}']).next().unwrap().parse().unwrap()
}

/// Starts a node that acts on a timer; `make` advertises its topics and returns what it does each
/// period.
pub fn timed<F: FnMut(&mut NodeContext<()>) + 'static>(
    process: &mut Process,
    name: &str,
    period: Duration,
    make: impl Fn(&mut NodeContext<()>) -> Result<F, NodeError> + Send + 'static,
) {
    process
        .start_closure(name, move |context: &mut NodeContext<()>| {
            context.timer(period, || ());
            let mut act = make(context)?;
            Ok(move |context: &mut NodeContext<()>, ()| act(context))
        })
        .unwrap();
}

/// Starts a node that hands each message of a topic to the closure that `make` returns.
pub fn listen<M: volant_msgs::Message, F: FnMut(Arc<M>) + 'static>(
    process: &mut Process,
    name: &str,
    topic: &'static str,
    preset: QosPreset,
    make: impl Fn() -> F + Send + 'static,
) {
    process
        .start_closure(name, move |context: &mut NodeContext<Arc<M>>| {
            context.subscribe(topic, preset, Some::<Arc<M>>)?;
            let mut take = make();
            Ok(move |_: &mut NodeContext<Arc<M>>, message: Arc<M>| take(message))
        })
        .unwrap();
}
