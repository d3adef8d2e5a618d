use super::*;

#[test]
fn the_derivatives_integrate_back_to_the_pose() {
    let motion = Motion::new(MotionConfig::fast_swing(3));
    let dt = 1e-3;
    let start = motion.kinematics(1.0);
    let (mut p, mut v, mut q) = (
        start.world_from_volant.translation.vector,
        start.velocity,
        start.world_from_volant.rotation,
    );
    for i in 0..1000 {
        let k = motion.kinematics(1.0 + (f64::from(i) + 0.5) * dt);
        p += v * dt + k.acceleration * (dt * dt / 2.0);
        v += k.acceleration * dt;
        q *= UnitQuaternion::from_scaled_axis(k.angular_velocity * dt);
    }
    let end = motion.kinematics(2.0);
    assert!((p - end.world_from_volant.translation.vector).norm() < 1e-5);
    assert!((v - end.velocity).norm() < 1e-5);
    assert!(q.angle_to(&end.world_from_volant.rotation) < 1e-5);
}

#[test]
fn the_motion_stays_within_its_bounds_and_in_front_of_the_camera() {
    for seed in 0..20 {
        let motion = Motion::new(MotionConfig::fast_swing(seed));
        for i in 0..1200 {
            let t = f64::from(i) * 0.01;
            let k = motion.kinematics(t);
            let tilt = (k.world_from_volant.rotation * Vector3::z()).z.acos();
            assert!(tilt < 0.55 + 0.09, "{seed} {t} {tilt}");
            let below =
                motion.world_from_climber(t).inverse() * k.world_from_volant.translation.vector;
            let offset = k.world_from_volant.translation.vector
                - motion.world_from_climber(t).translation.vector;
            assert!(offset.xy().norm() < 0.5 && below.norm() > 0.0, "{offset:?}");
        }
    }
}

#[test]
fn a_lap_ends_where_it_began() {
    let motion = Motion::new(MotionConfig {
        still_until: 0.0,
        still_from: 20.0,
        duration: 20.0,
        ramp: 5.0,
        ..MotionConfig::nominal(4)
    });
    let fastest = (0..2000)
        .map(|i| f64::from(i) * 0.01)
        .map(|t| {
            (motion.world_from_climber(t + 1e-3).translation.vector
                - motion.world_from_climber(t).translation.vector)
                .norm()
                * 1e3
        })
        .fold(0.0, f64::max);
    assert!(fastest < 2.0 * motion.config().climber_speed, "{fastest} m/s");
    let (start, end) = (motion.kinematics(0.0), motion.kinematics(20.0));
    assert!(
        (start.world_from_volant.inverse() * end.world_from_volant).translation.vector.norm()
            < 1e-9
    );
    assert!(end.velocity.norm() < 1e-6 && end.acceleration.norm() < 1e-3);
    assert!(motion.kinematics(10.0).velocity.norm() > 1e-3);
}

#[test]
fn the_only_force_on_a_free_platform_is_along_its_rope() {
    for seed in 0..4 {
        let motion =
            Motion::new(MotionConfig { free: true, wobble: 0.0, ..MotionConfig::nominal(seed) });
        for i in 0..120 {
            let t = f64::from(i) * 0.1;
            let k = motion.kinematics(t);
            let place = k.world_from_volant.translation.vector;
            let up = motion.pivot(t) - place;
            assert!((up.norm() - motion.rope_length()).abs() < 1e-8);
            let force = k.acceleration + Vector3::new(0.0, 0.0, 9.81);
            let across = force - up * (force.dot(&up) / up.norm_squared());
            assert!(across.norm() < 1e-4, "{t}: {}", across.norm());
            assert!(up.normalize().z > 0.9, "{t}: it swings too far, {up}");
        }
    }
}

#[test]
fn a_swinging_platform_s_accelerometer_points_along_the_rope() {
    let motion =
        Motion::new(MotionConfig { wobble: 0.0, climber_speed: 0.0, ..MotionConfig::nominal(5) });
    for i in 0..100 {
        let k = motion.kinematics(f64::from(i) * 0.1);
        let force = k.world_from_volant.rotation.inverse()
            * (k.acceleration + Vector3::new(0.0, 0.0, 9.81));
        let measured = force.xy().norm() / force.z;
        assert!(measured < 0.06, "{measured}");
    }
}
