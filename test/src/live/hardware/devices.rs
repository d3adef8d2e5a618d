//! Threads of the hardware: camera, encoders and IMU.

use super::{ImageSequence, LEAD, SensorMessage, Shared, lock, topics::Publishers};
use crate::live::{
    messages::{compressed_image, joint_state},
    scenario::{EXPOSURE, IMAGE_RATE},
};
use imu_driver::simulated_imu::{SimulatedSample, Source, pty::now};
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::convert;
use rig_model::Stamp;
use rig_simulator::random::Random;
use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

/// Publishes a message, or what the fault injector makes of it.
fn emit(shared: &Shared, publishers: &Publishers, message: SensorMessage) {
    let messages = match lock(&shared.injector).as_mut() {
        Some(injector) => injector(message),
        None => vec![(Duration::ZERO, message)],
    };
    for (delay, message) in messages {
        if delay.is_zero() {
            record(shared, &message);
            publishers.publish(message);
            continue;
        }
        // Only messages on time are recorded. A delayed one waits on a thread of its own.
        let publishers = publishers.clone();
        let late = move || {
            std::thread::sleep(delay);
            publishers.publish(message);
        };
        let _ = std::thread::Builder::new().name("late".to_owned()).spawn(late);
    }
}

fn record(shared: &Shared, message: &SensorMessage) {
    let now = now();
    if shared.endless || shared.seconds(now) < -LEAD {
        return;
    }
    let mut sent = lock(&shared.sent);
    match message {
        SensorMessage::Image(m) => sent.images.push((now, m.clone())),
        SensorMessage::CameraInfo(m) => sent.camera_info.push((now, m.clone())),
        SensorMessage::Joints(m) => sent.joints.push((now, m.clone())),
    }
}

/// Publishes the stationary images repeatedly until the scenario begins, then its images once.
pub(super) fn camera(shared: &Shared, publishers: &Publishers, images: &ImageSequence) {
    let frame_id = &shared.scenario.rig.frames.camera;
    let show = |stamp: Stamp, jpeg: &[u8]| {
        // The image is there when the shutter has closed.
        shared.sleep_until(stamp.plus_seconds(EXPOSURE / 2.0));
        if shared.stopped() {
            return;
        }
        let shown = shared.climber_clock(stamp);
        let image = compressed_image(shown, frame_id, jpeg.to_vec());
        emit(shared, publishers, SensorMessage::Image(image));
        let info = convert::camera_message(frame_id, shown, &shared.scenario.camera);
        emit(shared, publishers, SensorMessage::CameraInfo(info));
    };
    let mut stamp = now();
    'still: loop {
        for frame in &images.still {
            if shared.stopped() {
                return;
            }
            stamp = stamp.plus_seconds(1.0 / IMAGE_RATE);
            if shared.seconds(stamp) > -0.5 / IMAGE_RATE {
                break 'still;
            }
            show(stamp, &frame.jpeg);
        }
        if images.still.is_empty() {
            shared.sleep_until(stamp.plus_seconds(0.1));
            stamp = stamp.plus_seconds(0.1);
            if shared.stopped() || shared.seconds(stamp) > 0.0 {
                break;
            }
        }
    }
    let mut epoch = Stamp::from_nanos(shared.epoch.load(Ordering::Relaxed));
    loop {
        for frame in &images.frames {
            if shared.stopped() {
                return;
            }
            show(epoch.plus_seconds(frame.seconds), &frame.jpeg);
        }
        if !shared.endless || images.frames.is_empty() {
            return;
        }
        epoch = epoch.plus_seconds(shared.scenario.duration());
    }
}

/// Reads the encoders at their rate until the end.
pub(super) fn encoders(shared: &Shared, publishers: &Publishers) {
    let mut random = Random::fork(shared.scenario.sensors.seed, "live encoders");
    let mut stamp = now();
    while !shared.stopped() {
        stamp = stamp.plus_seconds(1.0 / shared.scenario.sensors.climber_rate);
        shared.sleep_until(stamp);
        let shown = shared.climber_clock(stamp);
        let joints = joint_state(&shared.scenario, &mut random, shared.seconds(stamp), shown);
        emit(shared, publishers, SensorMessage::Joints(joints));
    }
}

/// Samples of the IMU with noise, biases and a drifting attitude error.
pub(super) fn imu(shared: Arc<Shared>) -> Source {
    let mut random = Random::fork(shared.scenario.sensors.seed, "live unit");
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.within(-3.0, 3.0));
    let mut wander = Vector3::zeros();
    Box::new(move |at| {
        let Shared { scenario, .. } = &*shared;
        let (c, imu) = (&scenario.sensors, &scenario.rig.imu);
        let t = shared.seconds(at);
        let (force, rate) = scenario.simulated_sensors().ideal_imu(t);
        let mut white = |sigma: f64| {
            Vector3::new(random.normal(), random.normal(), random.normal())
                * sigma
                * c.imu_noise_factor
        };
        let per_sample = c.imu_rate.sqrt();
        // The attitude error wanders with a time constant of ten seconds.
        let keep = (-1.0 / (10.0 * c.imu_rate)).exp();
        wander = wander * keep + white(c.attitude_error * (1.0 - keep * keep).sqrt());
        SimulatedSample {
            specific_force: force
                + c.accelerometer_bias
                + white(imu.accelerometer_noise_density * per_sample),
            angular_velocity: rate
                + c.gyroscope_bias
                + white(imu.gyroscope_noise_density * per_sample),
            enu_from_imu: UnitQuaternion::from_scaled_axis(wander)
                * heading
                * scenario.motion.world_from_volant(t).rotation
                * imu.volant_from_imu.rotation,
            ..SimulatedSample::stationary()
        }
    })
}
