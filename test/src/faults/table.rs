//! The rows. The window is 3 s: the diagnostics, once a second, name a topic after 2 s without a
//! message.

use super::{
    Action, Flow, Row,
    injectors::{images, images_as, joints, joints_as, shift, uniform_images},
    recording,
};
use crate::live::{FaultInjector, Node, Run, processes::Signal};
use anyhow::{Context, Result};
use imu_driver::simulated_imu::SimulatedImu;
use rig_model::Stamp;
use std::time::Duration;

type Words = &'static [&'static str];
/// Node that reports the fault, and the words: see [`Row::diagnostics`].
type Report = Option<(&'static str, Words)>;

/// An action that cannot fail.
fn simply(f: impl Fn(&mut Run) + 'static) -> Action {
    Box::new(move |run, _| {
        f(run);
        Ok(())
    })
}

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A row in which the odometry is unbroken, no node is killed and the clock is left alone.
pub(super) fn row(
    fault: &'static str,
    diagnostics: Report,
    begin: Action,
    end: Action,
    back_within: f64,
) -> Row {
    let (flow, kills, clock_ahead) = (Flow::Unbroken, None, 0.0);
    Row { fault, begin, end, flow, diagnostics, back_within, kills, clock_ahead }
}

/// A row in which `make` changes the data of camera or encoders until the window ends.
fn sensor(
    fault: &'static str,
    diagnostics: Report,
    make: impl Fn() -> FaultInjector + 'static,
) -> Row {
    let begin = simply(move |run| run.hardware.inject(Some(make())));
    row(fault, diagnostics, begin, simply(|run| run.hardware.inject(None)), 1.0)
}

/// A row in which the IMU is treated with `begin`, and with `end` when the window ends.
fn unit(
    fault: &'static str,
    report: Words,
    begin: impl Fn(&mut Run) + 'static,
    end: impl Fn(&mut Run) + 'static,
) -> Row {
    let row = row(fault, Some(("imu_driver", report)), simply(begin), simply(end), 2.0);
    Row { flow: Flow::Stops, ..row }
}

/// Something that is done to the simulated IMU.
fn with_imu(f: fn(&mut SimulatedImu, Stamp)) -> impl Fn(&mut Run) {
    move |run| {
        let _ = run.hardware.imu().with(f);
    }
}

/// An action on the named node.
fn on(name: &'static str, f: fn(&mut Node) -> Result<()>) -> Action {
    Box::new(move |run, _| f(run.nodes.get(name).with_context(|| format!("no node {name}"))?))
}

/// The named node is killed as by `kill -9`, and started again when the window ends.
fn killed(fault: &'static str, name: &'static str, flow: Flow, diagnostics: Report) -> Row {
    let row = row(fault, diagnostics, on(name, Node::kill), on(name, Node::restart), 2.5);
    Row { flow, kills: Some(name), ..row }
}

/// Stops the named node for the window (SIGSTOP, SIGCONT), as on an overloaded computer.
fn stalled(fault: &'static str, name: &'static str, flow: Flow, diagnostics: Report) -> Row {
    Row {
        begin: on(name, |n| n.signal(Signal::STOP)),
        end: on(name, |n| n.signal(Signal::CONT)),
        ..killed(fault, name, flow, diagnostics)
    }
}

/// The clock of the nodes' computer is set ahead, and set right when the window ends.
fn clock_set(fault: &'static str, ahead: f64) -> Row {
    let set = |ahead: f64| -> Action { Box::new(move |run, _| run.set_clock(ahead)) };
    // One of the two steps leads back.
    let report: Report = Some(("pose_fusion", &["clock was set back"]));
    let row = row(fault, report, set(ahead), set(0.0), 1.5);
    Row { flow: Flow::Gaps, clock_ahead: ahead, ..row }
}

pub fn table() -> Vec<Row> {
    use Flow::{Gaps, Stops, Unbroken};
    let tracker = |words: Words| Some(("marker_tracker", words));
    let fusion = |words: Words| Some(("pose_fusion", words));
    let climber = |words: Words| Some(("climber_driver", words));
    vec![
        Row { back_within: 0.2, ..sensor("no fault (reference)", None, || images(|_| ())) },
        sensor(
            "camera frozen: the same image with new stamps",
            tracker(&["byte for byte"]),
            || {
                let mut first: Option<Vec<u8>> = None;
                images(move |m| m.data = first.get_or_insert_with(|| m.data.clone()).clone())
            },
        ),
        sensor("camera dark", tracker(&["nearly black"]), || uniform_images(640, 480, 0)),
        sensor("camera over-exposed", tracker(&["nearly white"]), || uniform_images(640, 480, 250)),
        sensor("camera drops two images of three", None, || {
            images_as(|i, m| if i % 3 == 0 { vec![(ms(0), m)] } else { vec![] })
        }),
        sensor("camera silent", tracker(&["no image arrived"]), || images_as(|_, _| vec![])),
        sensor(
            "camera sends another size",
            tracker(&["the images are 320x240, camera_info is for 640x480"]),
            || uniform_images(320, 240, 90),
        ),
        sensor("images cut off in the middle", tracker(&["rejected"]), || {
            images(|m| m.data.truncate(m.data.len() / 2))
        }),
        sensor("images doubled", None, || images_as(|_, m| vec![(ms(0), m.clone()), (ms(0), m)])),
        sensor("images late by 150 ms", None, || images_as(|_, m| vec![(ms(150), m)])),
        sensor("images out of order", None, || images_as(|i, m| vec![(ms(50 * (i % 2)), m)])),
        sensor("images stamped 10 s ahead", fusion(&["ahead of the IMU samples"]), || {
            images(|m| shift(&mut m.header, 10.0))
        }),
        sensor(
            "images stamped 10 s in the past",
            fusion(&["older than the newest IMU sample"]),
            || images(|m| shift(&mut m.header, -10.0)),
        ),
        sensor("encoder: every second reading off by 0.5 m", climber(&["jumped by"]), || {
            joints_as(|i, mut m| {
                m.position[0] += if i % 2 == 0 { 0.5 } else { 0.0 };
                vec![(ms(0), m)]
            })
        }),
        sensor("encoder: NaN", climber(&["is NaN"]), || joints(|m| m.position[1] = f64::NAN)),
        sensor("encoders stale: stamped 2 s ago", climber(&["old on arrival"]), || {
            joints(|m| shift(&mut m.header, -2.0))
        }),
        sensor("encoders silent", climber(&["no reading was accepted"]), || {
            joints_as(|_, _| vec![])
        }),
        sensor("encoder: a joint is missing", climber(&["is missing"]), || {
            joints(|m| {
                m.name.pop();
                m.position.pop();
            })
        }),
        sensor(
            "encoders from the future: stamped 2 s ahead",
            climber(&["after its receipt"]),
            || joints(|m| shift(&mut m.header, 2.0)),
        ),
        sensor("encoder readings out of order", None, || {
            joints_as(|i, m| vec![(ms(40 * (i % 2)), m)])
        }),
        sensor("encoder readings doubled and late by 60 ms", None, || {
            joints_as(|_, m| vec![(ms(60), m.clone()), (ms(60), m)])
        }),
        Row {
            flow: Gaps,
            ..unit(
                "serial garbage: 400 bytes, ten times",
                &["belonged to no message"],
                |run| {
                    for i in 0..10_u8 {
                        let garbage: Vec<u8> =
                            (0..400_u32).map(|k| (k as u8).wrapping_mul(37) ^ i | 0xC0).collect();
                        let _ =
                            run.hardware.imu().with(move |unit, now| unit.inject(&garbage, now));
                        std::thread::sleep(ms(100));
                    }
                },
                |_| {},
            )
        },
        unit(
            "serial silence (a broken wire)",
            &["no message for"],
            with_imu(|imu, _| imu.set_mute(true)),
            with_imu(|imu, _| imu.set_mute(false)),
        ),
        unit(
            "serial adapter unplugged",
            &["the serial port"],
            |run| run.hardware.imu().unplug(),
            |run| run.hardware.imu().replug(),
        ),
        // A power cycle takes a fraction of the window: the IMU is back before the window ends.
        Row {
            flow: Gaps,
            ..unit(
                "IMU off and on again",
                &["was set up again"],
                with_imu(|imu, now| imu.power_cycle(now)),
                |_| {},
            )
        },
        killed("kill -9 pose_fusion, started 3 s later", "pose_fusion", Stops, None),
        killed(
            "kill -9 marker_tracker, started 3 s later",
            "marker_tracker",
            Unbroken,
            fusion(&["no messages on /climber/markers"]),
        ),
        killed(
            "kill -9 imu_driver, started 3 s later",
            "imu_driver",
            Stops,
            fusion(&["no usable IMU sample for"]),
        ),
        killed(
            "kill -9 climber_driver, started 3 s later",
            "climber_driver",
            Unbroken,
            fusion(&["no messages on /climber/transform"]),
        ),
        stalled(
            "marker_tracker stalled for 3 s",
            "marker_tracker",
            Unbroken,
            fusion(&["no messages on /climber/markers"]),
        ),
        // After an interruption the domain is joined again, and the restart is reported instead.
        stalled(
            "pose_fusion stalled for 3 s",
            "pose_fusion",
            Gaps,
            fusion(&["stalled for", "restarted"]),
        ),
        stalled(
            "imu_driver stalled for 3 s",
            "imu_driver",
            Stops,
            fusion(&["no usable IMU sample for"]),
        ),
        stalled(
            "climber_driver stalled for 3 s",
            "climber_driver",
            Unbroken,
            fusion(&["no messages on /climber/transform"]),
        ),
        clock_set("system clock set 5 s ahead, and corrected", 5.0),
        clock_set("system clock set 5 s back, and corrected", -5.0),
        clock_set("system clock set 0.3 s ahead, and corrected", 0.3),
        recording::disk_full(),
    ]
}
