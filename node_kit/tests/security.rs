//! DDS security: a participant without a key of the keystore receives nothing and is not received.
//! Needs `--features security` and the `openssl` program.
#![cfg(feature = "security")]

mod common;

use common::{listen, timed};
use node_kit::{
    NodeContext, Process, QosPreset,
    environment::{Network, Security},
};
use parking_lot::Mutex;
use rustdds::{DomainParticipant, QosPolicyBuilder, TopicKind};
use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, mpsc::channel},
    time::Duration,
};
use volant_msgs::std_msgs::msg::Header;

/// Received messages: name of the listener, name of the talker.
type Received = Arc<Mutex<Vec<(String, String)>>>;

fn keystore(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch_config/setup/make-keystore");
    let status =
        Command::new(script).arg(&folder).args(["/rig/climber", "/rig/platform"]).status().unwrap();
    assert!(status.success());
    folder
}

fn join(name: &str, security: Option<Security>, received: &Received) -> Process {
    let mut process =
        Process::new(Network { domain_id: 31, security, ..Network::default() }).unwrap();
    let (talker, listener) = (format!("{name}_talker"), format!("{name}_listener"));
    let own = talker.clone();
    timed(&mut process, &talker, Duration::from_millis(50), move |context| {
        let secret = context.advertise::<Header>("/secret", QosPreset::State)?;
        let own = own.clone();
        Ok(move |_: &mut NodeContext<()>| {
            secret.publish(Header { frame_id: own.clone(), ..Header::default() });
        })
    });
    let (own, received) = (listener.clone(), Arc::clone(received));
    listen::<Header, _>(&mut process, &listener, "/secret", QosPreset::State, move || {
        let (own, received) = (own.clone(), Arc::clone(&received));
        move |message: Arc<Header>| received.lock().push((own.clone(), message.frame_id.clone()))
    });
    process
}

#[test]
fn a_participant_without_a_key_receives_and_injects_nothing() {
    let (ours, theirs) = (keystore("ours"), keystore("theirs"));
    let messages = Received::default();
    // Messages of one participant that another has received.
    let received = |listener: &str, talker: &str| {
        let names = (format!("{listener}_listener"), format!("{talker}_talker"));
        messages.lock().iter().filter(|message| **message == names).count()
    };
    let climber = join("climber", Some(Security::enforced(&ours, "/rig/climber")), &messages);
    let platform = join("platform", Some(Security::enforced(&ours, "/rig/platform")), &messages);
    let nobody = join("nobody", None, &messages);
    let stranger = join("stranger", Some(Security::enforced(&theirs, "/rig/climber")), &messages);
    for _ in 0..20 {
        if received("platform", "climber") > 20 && received("climber", "platform") > 20 {
            break;
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    std::thread::sleep(Duration::from_secs(2));
    // Members receive each other, and every participant receives itself, so the outsiders worked.
    assert!(received("platform", "climber") > 20, "{:?}", messages.lock());
    assert!(received("climber", "platform") > 20);
    for alone in ["nobody", "stranger"] {
        assert!(received(alone, alone) > 20);
        for insider in ["climber", "platform"] {
            assert_eq!(received(alone, insider), 0, "{alone} reads");
            assert_eq!(received(insider, alone), 0, "{alone} injects");
        }
    }
    drop((climber, platform, nobody, stranger));
}

/// RustDDS as published locks the participant and the security plugins in both orders, so that a
/// node hung at its start now and then, and its two threads wait for each other's queues
/// (`rustdds-11-security-lock-order` and `rustdds-12-discovery-commands` in `forks/patches`).
#[test]
fn topics_and_endpoints_are_created_at_once_without_a_deadlock() {
    let network = Network {
        domain_id: 68,
        security: Some(Security::enforced(keystore("lock-order"), "/rig/climber")),
        ..Network::default()
    };
    let (participant, _watch) = node_kit::node::join(&network).unwrap();
    let qos = QosPolicyBuilder::new().build();
    let topic = move |participant: &DomainParticipant, name: String| {
        let qos = QosPolicyBuilder::new().build();
        participant.create_topic(name, "T".to_owned(), &qos, TopicKind::NoKey).unwrap()
    };
    let (done, ended) = channel();
    let running = Arc::new(());
    let other = Arc::clone(&running);
    // Until the other thread has ended.
    std::thread::spawn({
        let (participant, done) = (participant.clone(), done.clone());
        move || {
            let mut numbers = 0..;
            while Arc::strong_count(&running) > 1 {
                let number = numbers.next().unwrap_or_default() % 100;
                drop(topic(&participant, format!("rt/topic{number}")));
                // The lock is not fair.
                std::thread::sleep(Duration::from_micros(20));
            }
            let _ = done.send(());
        }
    });
    std::thread::spawn(move || {
        let topic = topic(&participant, "rt/endpoint".to_owned());
        let subscriber = participant.create_subscriber(&qos).unwrap();
        let publisher = participant.create_publisher(&qos).unwrap();
        for _ in 0..100 {
            drop(subscriber.create_datareader_no_key_cdr::<u8>(&topic, None).unwrap());
            drop(publisher.create_datawriter_no_key_cdr::<u8>(&topic, None).unwrap());
        }
        drop(other);
        let _ = done.send(());
    });
    for _ in 0..2 {
        ended.recv_timeout(Duration::from_secs(60)).expect("a deadlock");
    }
}
