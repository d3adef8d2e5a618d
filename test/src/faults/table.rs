//! The rows. The window is 3 s: the diagnostics, once a second, name a topic after 2 s without a
//! message.

use super::{
    Action, Bench, Flow, Row,
    injectors::{images, joints, one, shift, uniform_images},
    recording,
};
use crate::live::{FaultInjector, ProcessError, RunError, processes::Signal};
use std::time::Duration;

type Words = &'static [&'static str];

pub(super) fn action(f: impl Fn(&mut Bench<'_>) -> Result<(), RunError> + 'static) -> Action {
    Box::new(f)
}

/// A row in which `make` changes the data of camera or encoders until the window ends.
fn sensor_fault(fault: &'static str, make: impl Fn() -> FaultInjector + 'static) -> Row {
    Row {
        fault,
        begin: action(move |b| {
            b.run.hardware.inject(Some(make()));
            Ok(())
        }),
        end: action(|b| {
            b.run.hardware.inject(None);
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
    report: Words,
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
        diagnostics: Some(("imu_driver", report)),
        back_within: 2.0,
        kills: None,
        clock_ahead: 0.0,
    }
}

/// The named node is killed as by `kill -9`, and started again when the window ends.
fn killed(fault: &'static str, name: &'static str) -> Row {
    let missing =
        move || RunError::Process(ProcessError::NotBuilt { name: name.into(), path: name.into() });
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

/// Stops the named node for the window (SIGSTOP, SIGCONT), as on an overloaded computer.
fn stalled(fault: &'static str, name: &'static str) -> Row {
    let missing =
        move || RunError::Process(ProcessError::NotBuilt { name: name.into(), path: name.into() });
    Row {
        begin: action(move |b| {
            Ok(b.run.nodes.get(name).ok_or_else(missing)?.signal(Signal::STOP)?)
        }),
        end: action(move |b| {
            Ok(b.run.nodes.get(name).ok_or_else(missing)?.signal(Signal::CONT)?)
        }),
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
        ..sensor_fault(fault, || images(one))
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
            ..sensor_fault("no fault (reference)", || images(one))
        },
        Row {
            diagnostics: tracker(&["byte for byte"]),
            ..sensor_fault("camera frozen: the same image with new stamps", || {
                let mut first: Option<Vec<u8>> = None;
                images(move |mut m| {
                    m.data = first.get_or_insert(m.data).clone();
                    one(m)
                })
            })
        },
        Row {
            diagnostics: tracker(&["nearly black"]),
            ..sensor_fault("camera dark", || uniform_images(640, 480, 0))
        },
        Row {
            diagnostics: tracker(&["nearly white"]),
            ..sensor_fault("camera over-exposed", || uniform_images(640, 480, 250))
        },
        sensor_fault("camera drops two images of three", || {
            let mut count = 0;
            images(move |m| {
                count += 1;
                if count % 3 == 0 { one(m) } else { Vec::new() }
            })
        }),
        Row {
            diagnostics: tracker(&["no image arrived"]),
            ..sensor_fault("camera silent", || images(|_| Vec::new()))
        },
        Row {
            diagnostics: tracker(&["the images are 320x240, camera_info is for 640x480"]),
            ..sensor_fault("camera sends another size", || uniform_images(320, 240, 90))
        },
        Row {
            diagnostics: tracker(&["rejected"]),
            ..sensor_fault("images cut off in the middle", || {
                images(|mut m| {
                    m.data.truncate(m.data.len() / 2);
                    one(m)
                })
            })
        },
        sensor_fault("images doubled", || {
            images(|m| vec![(Duration::ZERO, m.clone()), (Duration::ZERO, m)])
        }),
        sensor_fault("images late by 150 ms", || images(|m| vec![(Duration::from_millis(150), m)])),
        sensor_fault("images out of order", || {
            let mut late = false;
            images(move |m| {
                late = !late;
                vec![(Duration::from_millis(if late { 50 } else { 0 }), m)]
            })
        }),
        Row {
            diagnostics: fusion(&["ahead of the IMU samples"]),
            ..sensor_fault("images stamped 10 s ahead", || {
                images(|mut m| {
                    shift(&mut m.header, 10.0);
                    one(m)
                })
            })
        },
        Row {
            diagnostics: fusion(&["older than the newest IMU sample"]),
            ..sensor_fault("images stamped 10 s in the past", || {
                images(|mut m| {
                    shift(&mut m.header, -10.0);
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["jumped by"]),
            ..sensor_fault("encoder: every second reading off by 0.5 m", || {
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
            ..sensor_fault("encoder: NaN", || {
                joints(|mut m| {
                    m.position[1] = f64::NAN;
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["old on arrival"]),
            ..sensor_fault("encoders stale: stamped 2 s ago", || {
                joints(|mut m| {
                    shift(&mut m.header, -2.0);
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["no reading was accepted"]),
            ..sensor_fault("encoders silent", || joints(|_| Vec::new()))
        },
        Row {
            diagnostics: climber(&["is missing"]),
            ..sensor_fault("encoder: a joint is missing", || {
                joints(|mut m| {
                    m.name.pop();
                    m.position.pop();
                    one(m)
                })
            })
        },
        Row {
            diagnostics: climber(&["after its receipt"]),
            ..sensor_fault("encoders from the future: stamped 2 s ahead", || {
                joints(|mut m| {
                    shift(&mut m.header, 2.0);
                    one(m)
                })
            })
        },
        sensor_fault("encoder readings out of order", || {
            let mut late = false;
            joints(move |m| {
                late = !late;
                vec![(Duration::from_millis(if late { 40 } else { 0 }), m)]
            })
        }),
        sensor_fault("encoder readings doubled and late by 60 ms", || {
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
                        let _ =
                            b.run.hardware.imu().with(move |unit, now| unit.inject(&garbage, now));
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
                let _ = b.run.hardware.imu().with(|unit, _| unit.set_mute(true));
            },
            |b| {
                let _ = b.run.hardware.imu().with(|unit, _| unit.set_mute(false));
            },
        ),
        unit(
            "serial adapter unplugged",
            &["the serial port"],
            |b| b.run.hardware.imu().unplug(),
            |b| b.run.hardware.imu().replug(),
        ),
        // A power cycle takes a fraction of the window: the IMU is back before the window ends.
        Row {
            flow: Flow::Gaps,
            ..unit(
                "IMU off and on again",
                &["was set up again"],
                |b| {
                    let _ = b.run.hardware.imu().with(|unit, now| unit.power_cycle(now));
                },
                |_| {},
            )
        },
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
            // After an interruption the domain is joined again, and the restart is reported
            // instead.
            diagnostics: fusion(&["stalled for", "restarted"]),
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
        clock_set("system clock set 5 s ahead, and corrected", 5.0),
        clock_set("system clock set 5 s back, and corrected", -5.0),
        clock_set("system clock set 0.3 s ahead, and corrected", 0.3),
        recording::disk_full(),
    ]);
    rows
}
