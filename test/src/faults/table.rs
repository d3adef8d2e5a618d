//! The rows. A window of 3 s: long enough that the diagnostics, once a second, name what is missing for 2 s.

use super::{
    Action, Bench, Flow, Row, recording,
    spoilers::{even_pictures, images, joints, one, shift},
};
use crate::live::{ProcessError, RunError, Spoiler, processes::Signal};
use std::time::Duration;

type Words = &'static [&'static str];

pub(super) fn action(f: impl Fn(&mut Bench<'_>) -> Result<(), RunError> + 'static) -> Action {
    Box::new(f)
}

/// A row in which camera or encoders speak as `make` has them, until the window ends.
fn spoiled(fault: &'static str, make: impl Fn() -> Spoiler + 'static) -> Row {
    Row {
        fault,
        begin: action(move |b| {
            b.run.stand.spoil(Some(make()));
            Ok(())
        }),
        end: action(|b| {
            b.run.stand.spoil(None);
            Ok(())
        }),
        flow: Flow::Unbroken,
        diagnostics: None,
        back_within: 1.0,
        kills: None,
        clock_ahead: 0.0,
    }
}

/// A row in which the inertial unit is treated with `begin`, and with `end` when the window ends.
fn unit(
    fault: &'static str,
    said: Words,
    begin: impl Fn(&mut Bench<'_>) + 'static,
    end: impl Fn(&mut Bench<'_>) + 'static,
) -> Row {
    Row {
        fault,
        begin: action(move |b| {
            begin(b);
            Ok(())
        }),
        end: action(move |b| {
            end(b);
            Ok(())
        }),
        flow: Flow::Stops,
        diagnostics: Some(("imu_driver", said)),
        back_within: 2.0,
        kills: None,
        clock_ahead: 0.0,
    }
}

/// The named node is killed as by `kill -9`, and started again when the window ends.
fn killed(fault: &'static str, name: &'static str) -> Row {
    let missing = move || RunError::Process(ProcessError::NotBuilt { name: name.into(), path: name.into() });
    Row {
        fault,
        begin: action(move |b| Ok(b.run.nodes.get(name).ok_or_else(missing)?.kill()?)),
        end: action(move |b| Ok(b.run.nodes.get(name).ok_or_else(missing)?.restart()?)),
        flow: Flow::Unbroken,
        diagnostics: None,
        back_within: 2.5,
        kills: Some(name),
        clock_ahead: 0.0,
    }
}

/// The named node is stopped for the window (SIGSTOP, SIGCONT), as on a computer that is overloaded.
fn stalled(fault: &'static str, name: &'static str) -> Row {
    let missing = move || RunError::Process(ProcessError::NotBuilt { name: name.into(), path: name.into() });
    Row {
        begin: action(move |b| Ok(b.run.nodes.get(name).ok_or_else(missing)?.signal(Signal::STOP)?)),
        end: action(move |b| Ok(b.run.nodes.get(name).ok_or_else(missing)?.signal(Signal::CONT)?)),
        ..killed(fault, name)
    }
}

/// The clock of the nodes' computer is set ahead, and set right when the window ends.
fn clock_set(fault: &'static str, ahead: f64) -> Row {
    Row {
        begin: action(move |b| b.run.set_clock(ahead)),
        end: action(|b| b.run.set_clock(0.0)),
        flow: Flow::Gaps,
        // One of the two steps leads back.
        diagnostics: Some(("pose_fusion", &["clock was set back"])),
        back_within: 1.5,
        clock_ahead: ahead,
        ..spoiled(fault, || images(one))
    }
}

/// Every fault.
pub fn table() -> Vec<Row> {
    let tracker = |words: Words| Some(("marker_tracker", words));
    let fusion = |words: Words| Some(("pose_fusion", words));
    let climber = |words: Words| Some(("climber_driver", words));
    let mut rows = vec![
        Row {
            flow: Flow::Unbroken,
            diagnostics: None,
            back_within: 0.2,
            ..spoiled("nothing (to compare with)", || images(one))
        },
        Row {
            diagnostics: tracker(&["byte for byte"]),
            ..spoiled("camera frozen: the same picture with new stamps", || {
                let mut first: Option<Vec<u8>> = None;
                images(move |mut m| {
                    m.data = first.get_or_insert(m.data).clone();
                    one(m)
                })
            })
        },
        Row {
            diagnostics: tracker(&["nearly black"]),
            ..spoiled("camera dark", || even_pictures(640, 480, 0))
        },
        Row {
            diagnostics: tracker(&["nearly white"]),
            ..spoiled("camera over-exposed", || even_pictures(640, 480, 250))
        },
        spoiled("camera drops two pictures of three", || {
            let mut count = 0;
            images(move |m| {
                count += 1;
                if count % 3 == 0 { one(m) } else { Vec::new() }
            })
        }),
        Row {
            diagnostics: tracker(&["no image came"]),
            ..spoiled("camera silent", || images(|_| Vec::new()))
        },
        Row {
            diagnostics: tracker(&["the images are 320x240, camera_info is for 640x480"]),
            ..spoiled("camera sends another size", || even_pictures(320, 240, 90))
        },
        Row {
            diagnostics: tracker(&["refused"]),
            ..spoiled("pictures cut off in their middle", || {
                images(|mut m| {
                    m.data.truncate(m.data.len() / 2);
                    one(m)
                })
            })
        },
        spoiled("pictures doubled", || images(|m| vec![(Duration::ZERO, m.clone()), (Duration::ZERO, m)])),
        spoiled("pictures late by 150 ms", || images(|m| vec![(Duration::from_millis(150), m)])),
        spoiled("pictures out of order", || {
            let mut late = false;
            images(move |m| {
                late = !late;
                vec![(Duration::from_millis(if late { 50 } else { 0 }), m)]
            })
        }),
        Row {
            diagnostics: fusion(&["ahead of the IMU samples"]),
            ..spoiled("pictures stamped 10 s ahead", || {
                images(|mut m| {
                    shift(&mut m.header, 10.0);
                    one(m)
                })
            })
        },
        Row {
            diagnostics: fusion(&["older than the newest IMU sample"]),
            ..spoiled("pictures stamped 10 s in the past", || {
                images(|mut m| {
                    shift(&mut m.header, -10.0);
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["jumped by"]),
            ..spoiled("encoder: every second reading off by 0.5 m", || {
                let mut count = 0;
                joints(move |mut m| {
                    count += 1;
                    if count % 2 == 0 {
                        m.position[0] += 0.5;
                    }
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["is NaN"]),
            ..spoiled("encoder: NaN", || {
                joints(|mut m| {
                    m.position[1] = f64::NAN;
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["old on arrival"]),
            ..spoiled("encoders stale: stamped 2 s ago", || {
                joints(|mut m| {
                    shift(&mut m.header, -2.0);
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["no reading was accepted"]),
            ..spoiled("encoders silent", || joints(|_| Vec::new()))
        },
        Row {
            diagnostics: climber(&["is missing"]),
            ..spoiled("encoder: a joint is missing", || {
                joints(|mut m| {
                    m.name.pop();
                    m.position.pop();
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["after its receipt"]),
            ..spoiled("encoders from the future: stamped 2 s ahead", || {
                joints(|mut m| {
                    shift(&mut m.header, 2.0);
                    one(m)
                })
            })
        },
        spoiled("encoder readings out of order", || {
            let mut late = false;
            joints(move |m| {
                late = !late;
                vec![(Duration::from_millis(if late { 40 } else { 0 }), m)]
            })
        }),
        spoiled("encoder readings doubled and late by 60 ms", || {
            joints(|m| vec![(Duration::from_millis(60), m.clone()), (Duration::from_millis(60), m)])
        }),
    ];
    rows.extend([
        Row {
            flow: Flow::Gaps,
            ..unit(
                "serial garbage: 400 bytes, ten times",
                &["belonged to no message"],
                |b| {
                    for i in 0..10_u8 {
                        let garbage: Vec<u8> =
                            (0..400_u32).map(|k| (k as u8).wrapping_mul(37) ^ i | 0xC0).collect();
                        let _ = b.run.stand.unit().with(move |unit, now| unit.inject(&garbage, now));
                        std::thread::sleep(Duration::from_millis(100));
                    }
                },
                |_| {},
            )
        },
        unit(
            "serial silence (a broken wire)",
            &["no message for"],
            |b| {
                let _ = b.run.stand.unit().with(|unit, _| unit.set_mute(true));
            },
            |b| {
                let _ = b.run.stand.unit().with(|unit, _| unit.set_mute(false));
            },
        ),
        unit(
            "serial adapter unplugged",
            &["the serial port"],
            |b| b.run.stand.unit().unplug(),
            |b| b.run.stand.unit().replug(),
        ),
        unit(
            "inertial unit off and on again",
            &["was set up again"],
            |b| {
                let _ = b.run.stand.unit().with(|unit, now| unit.power_cycle(now));
            },
            |_| {},
        ),
        Row {
            flow: Flow::Stops,
            diagnostics: None,
            ..killed("kill -9 pose_fusion, started 3 s later", "pose_fusion")
        },
        Row {
            diagnostics: fusion(&["nothing comes on /climber/markers"]),
            ..killed("kill -9 marker_tracker, started 3 s later", "marker_tracker")
        },
        Row {
            flow: Flow::Stops,
            diagnostics: fusion(&["no IMU sample for"]),
            ..killed("kill -9 imu_driver, started 3 s later", "imu_driver")
        },
        Row {
            diagnostics: fusion(&["nothing comes on /climber/transform"]),
            ..killed("kill -9 climber_driver, started 3 s later", "climber_driver")
        },
        Row {
            diagnostics: fusion(&["nothing comes on /climber/markers"]),
            ..stalled("marker_tracker stalled for 3 s", "marker_tracker")
        },
        Row {
            flow: Flow::Gaps,
            // An interrupted middleware is joined anew, which takes the place of having stood still.
            diagnostics: fusion(&["stood still for", "started anew"]),
            ..stalled("pose_fusion stalled for 3 s", "pose_fusion")
        },
        Row {
            flow: Flow::Stops,
            diagnostics: fusion(&["no IMU sample for"]),
            ..stalled("imu_driver stalled for 3 s", "imu_driver")
        },
        Row {
            diagnostics: fusion(&["nothing comes on /climber/transform"]),
            ..stalled("climber_driver stalled for 3 s", "climber_driver")
        },
        clock_set("the computer's clock set 5 s ahead, and right again", 5.0),
        clock_set("the computer's clock set 5 s back, and right again", -5.0),
        clock_set("the computer's clock set 0.3 s ahead, and right again", 0.3),
        recording::disk_full(),
    ]);
    // Off and on again takes the unit a fraction of the window: it is back before the window ends.
    for row in &mut rows {
        if row.fault.starts_with("inertial unit off") {
            row.flow = Flow::Gaps;
        }
    }
    rows
}
