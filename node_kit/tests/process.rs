//! Several nodes in one process: the same `Arc` for subscribers inside, DDS for those outside, each
//! message once.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use node_kit::{
    NodeContext, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments,
    environment::Network,
};
use std::{
    sync::{Arc, mpsc},
    time::Duration,
};
use volant_msgs::sensor_msgs::msg::Image;

/// Name of the node, and the image that it published or received.
type Report = (&'static str, Arc<Image>);
type Reports = mpsc::SyncSender<Report>;

struct Source {
    images: Publisher<Image>,
    number: u32,
    reports: Reports,
}

impl Source {
    fn new(context: &mut NodeContext<()>, reports: Reports) -> Result<Self, NodeError> {
        context.timer(Duration::from_millis(20), || ());
        Ok(Self { images: context.advertise("image", QosPreset::Image)?, number: 0, reports })
    }
}

impl NodeShell for Source {
    const NAME: &'static str = "source";
    type Parameters = ();
    type Input = ();

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {
        self.number += 1;
        let image =
            Arc::new(Image { width: self.number, data: vec![7; 100_000], ..Image::default() });
        let _ = self.reports.try_send(("source", Arc::clone(&image)));
        self.images.publish_shared(image);
    }
}

struct Sink(Reports);

impl Sink {
    fn new(context: &mut NodeContext<Arc<Image>>, reports: Reports) -> Result<Self, NodeError> {
        context.subscribe("image", QosPreset::Image, Some)?;
        Ok(Self(reports))
    }
}

impl NodeShell for Sink {
    const NAME: &'static str = "sink";
    type Parameters = ();
    type Input = Arc<Image>;

    fn handle(&mut self, context: &mut NodeContext<Arc<Image>>, image: Arc<Image>) {
        let who = if context.name().base() == "outside" { "outside" } else { "inside" };
        let _ = self.0.try_send((who, image));
    }
}

struct Broken;

impl NodeShell for Broken {
    const NAME: &'static str = "broken";
    type Parameters = ();
    type Input = ();

    fn start(context: &mut NodeContext<()>, (): ()) -> Result<Self, NodeError> {
        context.timer(Duration::from_millis(1), || ());
        Ok(Self)
    }

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {
        panic!("on purpose");
    }
}

/// Handles its timer more slowly than the timer's period, and ends by its tick.
struct Slow;

impl NodeShell for Slow {
    const NAME: &'static str = "slow";
    type Parameters = ();
    type Input = ();

    fn start(context: &mut NodeContext<()>, (): ()) -> Result<Self, NodeError> {
        context.timer(Duration::from_millis(1), || ());
        Ok(Self)
    }

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {
        std::thread::sleep(Duration::from_millis(3));
    }

    fn tick(&mut self, context: &mut NodeContext<()>) {
        context.finish();
    }
}

fn network(domain_id: u16) -> Network {
    Network { domain_id, ..Network::default() }
}

#[test]
fn inside_it_is_the_same_image_outside_a_copy_and_each_comes_once() {
    let (sender, reports) = mpsc::sync_channel(1000);
    let sink = || {
        let reports = sender.clone();
        move |context: &mut NodeContext<_>, ()| Sink::new(context, reports.clone())
    };
    let reports_of_source = sender.clone();
    let arguments = RosArguments::default();
    let mut inside = Process::new(network(21)).unwrap();
    inside.start_with(&arguments, sink()).unwrap();
    inside
        .start_with(&arguments, move |context, ()| Source::new(context, reports_of_source.clone()))
        .unwrap();
    // Another participant, like another process.
    let mut outside = Process::new(network(21)).unwrap();
    let mut renamed = RosArguments::default();
    renamed.remap("__node", "outside");
    outside.start_with(&renamed, sink()).unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    drop(inside);
    drop(outside);
    let all: Vec<_> = reports.try_iter().collect();
    let of = |who| all.iter().filter(|(w, _)| *w == who).map(|(_, i)| i).collect::<Vec<_>>();
    let (source, inside, outside) = (of("source"), of("inside"), of("outside"));
    assert!(source.len() > 30, "{}", source.len());
    // Same images in the same order; the last may have arrived after the end.
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
    let mut process = Process::new(network(22)).unwrap();
    process.start::<Slow>(&RosArguments::default()).unwrap();
    process.start::<Broken>(&RosArguments::default()).unwrap();
    let error = process.wait().unwrap_err().to_string();
    assert!(error.contains("/broken") && error.contains("on purpose"), "{error}");
}

#[test]
fn a_handler_slower_than_its_timer_holds_up_nothing_else() {
    let mut process = Process::new(network(23)).unwrap();
    process.start::<Slow>(&RosArguments::default()).unwrap();
    process.wait().unwrap();
}
