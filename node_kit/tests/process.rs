//! Several nodes in one process: the same `Arc` for subscribers inside, DDS for those outside, each message once.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use node_kit::{
    Kit, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments, environment::Network,
};
use std::{
    sync::{Arc, Mutex, mpsc},
    time::Duration,
};
use volant_msgs::{sensor_msgs::msg::Image, std_msgs::msg::Header};

/// Who, and what it had in its hands.
type Report = (&'static str, Arc<Image>);

/// Serial: the tests share what the shells report to.
static REPORTS: Mutex<Option<mpsc::SyncSender<Report>>> = Mutex::new(None);
static SERIAL: Mutex<()> = Mutex::new(());

fn report(who: &'static str, image: Arc<Image>) {
    if let Some(sender) = &*REPORTS.lock().unwrap() {
        let _ = sender.try_send((who, image));
    }
}

struct Source(Publisher<Image>, u32);

impl NodeShell for Source {
    const NAME: &'static str = "source";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        kit.timer(Duration::from_millis(20), || ());
        Ok(Self(kit.advertise("image", QosPreset::Image)?, 0))
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {
        self.1 += 1;
        let image = Arc::new(Image { width: self.1, data: vec![7; 100_000], ..Image::default() });
        report("source", Arc::clone(&image));
        self.0.publish_shared(image);
    }
}

struct Sink;

impl NodeShell for Sink {
    const NAME: &'static str = "sink";
    type Parameters = ();
    type Input = Arc<Image>;

    fn start(kit: &mut Kit<Arc<Image>>, (): ()) -> Result<Self, NodeError> {
        kit.subscribe("image", QosPreset::Image, Some)?;
        Ok(Self)
    }

    fn handle(&mut self, kit: &mut Kit<Arc<Image>>, image: Arc<Image>) {
        let who = if kit.name().base() == "outside" { "outside" } else { "inside" };
        report(who, image);
    }
}

struct Broken;

impl NodeShell for Broken {
    const NAME: &'static str = "broken";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        kit.timer(Duration::from_millis(1), || ());
        Ok(Self)
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {
        panic!("as the test wants it");
    }
}

struct OtherType;

impl NodeShell for OtherType {
    const NAME: &'static str = "other_type";
    type Parameters = ();
    type Input = Arc<Header>;

    fn start(kit: &mut Kit<Arc<Header>>, (): ()) -> Result<Self, NodeError> {
        kit.subscribe("image", QosPreset::State, Some)?;
        Ok(Self)
    }

    fn handle(&mut self, _: &mut Kit<Arc<Header>>, _: Arc<Header>) {}
}

fn network(domain_id: u16) -> Network {
    Network { domain_id, ..Network::default() }
}

#[test]
fn inside_it_is_the_same_image_outside_a_copy_and_each_comes_once() {
    let _serial = SERIAL.lock().unwrap_or_else(|e| e.into_inner());
    let (sender, reports) = mpsc::sync_channel(1000);
    *REPORTS.lock().unwrap() = Some(sender);
    let arguments = RosArguments::default();
    let mut inside = Process::new(network(21)).unwrap();
    inside.start::<Sink>(&arguments).unwrap();
    inside.start::<Source>(&arguments).unwrap();
    // Another participant: as if it were another process.
    let mut outside = Process::new(network(21)).unwrap();
    let mut renamed = RosArguments::default();
    renamed.remap("__node", "outside");
    outside.start::<Sink>(&renamed).unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    drop(inside);
    drop(outside);
    *REPORTS.lock().unwrap() = None;
    let all: Vec<_> = reports.try_iter().collect();
    let of = |who| all.iter().filter(|(w, _)| *w == who).map(|(_, i)| i).collect::<Vec<_>>();
    let (source, inside, outside) = (of("source"), of("inside"), of("outside"));
    assert!(source.len() > 30, "{}", source.len());
    // Same images in the same order; the last may have come after the end.
    assert!(source.len() - inside.len() <= 1, "{} of {}", inside.len(), source.len());
    assert!(inside.iter().zip(&source).all(|(a, b)| Arc::ptr_eq(a, b)));
    assert!(outside.len() > 20, "{} of {}", outside.len(), source.len());
    for image in &outside {
        let original = source.iter().find(|s| s.width == image.width).unwrap();
        assert!(!Arc::ptr_eq(image, original) && image == original);
    }
    let mut numbers: Vec<_> = outside.iter().map(|i| i.width).collect();
    numbers.dedup();
    assert_eq!(numbers.len(), outside.len());
}

#[test]
fn a_node_that_breaks_is_named_and_ends_the_process_in_order() {
    let _serial = SERIAL.lock().unwrap_or_else(|e| e.into_inner());
    let mut process = Process::new(network(22)).unwrap();
    process.start::<Source>(&RosArguments::default()).unwrap();
    process.start::<Broken>(&RosArguments::default()).unwrap();
    let error = process.wait().unwrap_err().to_string();
    assert!(error.contains("/broken") && error.contains("as the test wants it"), "{error}");
}

#[test]
fn a_topic_has_one_type_in_a_process() {
    let _serial = SERIAL.lock().unwrap_or_else(|e| e.into_inner());
    let mut process = Process::new(network(23)).unwrap();
    process.start::<Source>(&RosArguments::default()).unwrap();
    let error = process.start::<OtherType>(&RosArguments::default()).unwrap_err().to_string();
    assert!(error.contains("/image") && error.contains("sensor_msgs/msg/Image"), "{error}");
}

#[test]
fn a_stopper_ends_all_nodes() {
    let _serial = SERIAL.lock().unwrap_or_else(|e| e.into_inner());
    let mut process = Process::new(network(24)).unwrap();
    process.start::<Source>(&RosArguments::default()).unwrap();
    process.start::<Sink>(&RosArguments::default()).unwrap();
    let stopper = process.stopper();
    let stopping = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(100));
        stopper.stop();
    });
    process.wait().unwrap();
    stopping.join().unwrap();
}

/// ros2-client's own client speaks as Fast DDS's does: the identity of a request travels beside it.
#[test]
fn services_answer_clients_of_fast_dds_too() {
    use ros2_client::{
        Context, Name, NodeName, NodeOptions, QosProfile, ServiceMapping, ServiceTypeName,
        qos::WhenFull,
        rcl_interfaces::{GetParametersRequest, GetParametersResponse},
    };
    let _serial = SERIAL.lock().unwrap_or_else(|e| e.into_inner());
    let mut process = Process::new(network(25)).unwrap();
    process.start::<Source>(&RosArguments::default()).unwrap();

    let participant = rustdds::DomainParticipantBuilder::new(25).build().unwrap();
    let context = Context::from_domain_participant(participant).unwrap();
    let mut node = context
        .new_node(NodeName::new("/", "client").unwrap(), NodeOptions::new().enable_rosout(false))
        .unwrap();
    let qos = QosProfile::publisher_default().reliability_reliable(WhenFull::Fail);
    let client = node
        .create_client::<GetParametersRequest, GetParametersResponse>(
            ServiceMapping::Enhanced,
            &Name::parse("/source/get_parameters").unwrap(),
            &ServiceTypeName::new("rcl_interfaces", "GetParameters"),
            qos.clone(),
            qos,
        )
        .unwrap();
    let names = vec!["autostart".to_owned(), "frames.world".to_owned(), "no_such".to_owned()];
    let answer = (0..100).find_map(|round| {
        // Until both sides have found each other, requests go nowhere.
        if round % 10 == 0 {
            client.send_request(GetParametersRequest { names: names.clone() }).unwrap();
        }
        std::thread::sleep(Duration::from_millis(50));
        client.receive_response().unwrap()
    });
    let (_, answer) = answer.expect("an answer within 5 s");
    assert_eq!(answer.values.len(), 3);
    assert!(answer.values[0].boolean_value);
    assert_eq!(answer.values[1].string_value, "world");
    assert_eq!(answer.values[2].ptype, 0);
}
