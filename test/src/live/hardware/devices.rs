//! Threads of the hardware: camera, encoders and IMU.

use super::{
    FaultInjector, ImageSequence, LEAD, Shared, lock,
    topics::{ListOf, Publishers},
};
use crate::live::scenario::{EXPOSURE, IMAGE_RATE};
use imu_driver::simulated_imu::{SimulatedSample, Source, pty::now};
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::{convert, node::Publisher};
use rig_model::Stamp;
use rig_simulator::random::Random;
use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};
use volant_msgs::{
    Message,
    sensor_msgs::msg::{CompressedImage, JointState},
};

/// Publishes messages, each after its delay, and keeps those on time in `list`, from shortly before
/// the scenario's zero on.
fn emit<M: Message>(
    shared: &Shared,
    publisher: &Publisher<M>,
    list: ListOf<M>,
    messages: Vec<(Duration, M)>,
) {
    for (delay, message) in messages {
        let message = Arc::new(message);
        if delay.is_zero() {
            let now = now();
            if !shared.endless && shared.seconds(now) >= -LEAD {
                list(&mut lock(&shared.received)).push((now, Arc::clone(&message)));
            }
            publisher.publish_shared(message);
            continue;
        }
        // A delayed one waits on a thread of its own.
        let publisher = publisher.clone();
        let late = move || {
            std::thread::sleep(delay);
            publisher.publish_shared(message);
        };
        let _ = std::thread::Builder::new().name("late".to_owned()).spawn(late);
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
        let image = CompressedImage {
            header: convert::header(frame_id, shown),
            format: "rgb8; jpeg compressed bgr8".to_owned(),
            data: jpeg.to_vec(),
        };
        let images = match lock(&shared.injector).as_mut() {
            Some(FaultInjector::Images(replace)) => replace(image),
            _ => vec![(Duration::ZERO, image)],
        };
        emit(shared, &publishers.image, |log| &mut log.images, images);
        let info = convert::camera_message(frame_id, shown, &shared.scenario.camera);
        let info = vec![(Duration::ZERO, info)];
        emit(shared, &publishers.camera_info, |log| &mut log.camera_info, info);
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
        let sensors = shared.scenario.simulated_sensors();
        let joints = JointState {
            header: convert::header("", shared.climber_clock(stamp)),
            name: ["rail_x", "rail_y", "turn"].map(str::to_owned).to_vec(),
            position: sensors.encoders(shared.seconds(stamp), &mut random).to_vec(),
            ..JointState::default()
        };
        let readings = match lock(&shared.injector).as_mut() {
            Some(FaultInjector::Joints(replace)) => replace(joints),
            _ => vec![(Duration::ZERO, joints)],
        };
        emit(shared, &publishers.joints, |log| &mut log.joints, readings);
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
