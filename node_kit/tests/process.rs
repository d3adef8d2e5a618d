//! Several nodes in one process: the same `Arc` for subscribers inside, DDS for those outside, each
//! message once.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{listen, timed};
use node_kit::{NodeContext, Process, QosPreset, environment::Network};
use std::{
    sync::{Arc, mpsc},
    time::Duration,
};
use volant_msgs::sensor_msgs::msg::Image;

fn network(domain_id: u16) -> Network {
    Network { domain_id, ..Network::default() }
}

#[test]
fn inside_it_is_the_same_image_outside_a_copy_and_each_comes_once() {
    // Name of the node, and the image that it published or received.
    let (sender, reports) = mpsc::sync_channel::<(&'static str, Arc<Image>)>(1000);
    let sink = |process: &mut Process, name: &'static str| {
        let reports = sender.clone();
        listen::<Image, _>(process, name, "image", QosPreset::Image, move || {
            let reports = reports.clone();
            move |image: Arc<Image>| {
                let _ = reports.try_send((name, image));
            }
        });
    };
    let mut inside = Process::new(network(21)).unwrap();
    sink(&mut inside, "inside");
    let reports_of_source = sender.clone();
    timed(&mut inside, "source", Duration::from_millis(20), move |context| {
        let images = context.advertise::<Image>("image", QosPreset::Image)?;
        let (reports, mut number) = (reports_of_source.clone(), 0);
        Ok(move |_: &mut NodeContext<()>| {
            number += 1;
            let image = Image { width: number, data: vec![7; 100_000], ..Image::default() };
            let image = Arc::new(image);
            let _ = reports.try_send(("source", Arc::clone(&image)));
            images.publish_shared(image);
        })
    });
    // Another participant, like another process.
    let mut outside = Process::new(network(21)).unwrap();
    sink(&mut outside, "outside");
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
    let period = Duration::from_millis(20);
    timed(&mut process, "well", period, |_| Ok(|_: &mut NodeContext<()>| {}));
    timed(&mut process, "broken", period, |_| Ok(|_: &mut NodeContext<()>| panic!("on purpose")));
    let error = process.wait().unwrap_err().to_string();
    assert!(error.contains("/broken") && error.contains("on purpose"), "{error}");
}

#[test]
fn a_handler_slower_than_its_timer_holds_up_nothing_else() {
    let mut process = Process::new(network(23)).unwrap();
    timed(&mut process, "slow", Duration::from_millis(1), |_| {
        let mut left = 20;
        Ok(move |context: &mut NodeContext<()>| {
            std::thread::sleep(Duration::from_millis(3));
            left -= 1;
            if left == 0 {
                context.finish();
            }
        })
    });
    process.wait().unwrap();
}
