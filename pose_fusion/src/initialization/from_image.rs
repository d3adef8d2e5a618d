//! Initial state from one image, the IMU's direction of "up" and the encoders. Equations:
//! `docs/src/equations.md`, "Initialization".

use crate::{
    adaptation::layout_misfit,
    config::TightConfig,
    ekf::{
        calibration::{Calibration, OFFSETS},
        consider::ByParameter,
        propagation::ImuReading,
        state::{
            ACCELEROMETER_BIAS, ATTITUDE, CLIMBER, CLIMBER_ACCELERATION, CLIMBER_RATE,
            GYROSCOPE_BIAS, POSITION, State, TIME_OFFSET, VELOCITY,
        },
        update,
    },
    initialization::ambiguity::Candidate,
    input::{
        climber_track::{ClimberAt, DRIVE_ACCELERATION},
        imu::Up,
    },
    measurements::{
        encoders::by_parameter,
        geometry::Geometry,
        marker_misfit::{Misfit, misfit},
        marker_prediction::linearize,
        markers::{self, Image, ImageInnovation, Pixels},
    },
};
use nalgebra::{Isometry3, Matrix2, Point3, UnitQuaternion, Vector3};
use rig_model::{
    PerColor,
    planar_pose::{self, PlanarPose, TiltPrior},
};

/// Largest cost of an image whose markers fit a pose: 2n − 6 (+ 2 for the tilt) degrees of freedom.
pub const LARGEST_COST: f64 = 40.0;
/// Largest squared misfit of four markers that fit: χ² quantile (0.9999), 2 degrees of freedom.
const LARGEST_MISFIT: f64 = 18.42;
/// A pose that fits worse than another by this (χ², 5 sigma) is not the right one.
const CLEAR: f64 = 25.0;
/// Initial position and attitude uncertainty, m and rad: so wide that the image decides.
const OPEN: [f64; 2] = [2.0, 1.0];

/// Initial state after the image, with the image's records.
#[derive(Clone, Debug)]
pub struct InitialEstimate {
    /// State.
    pub state: State,
    /// Records of the image's markers.
    pub record: ImageInnovation,
    /// Factor on the variance of the image's pixels with which the markers fit together.
    pub noise_factor: f64,
}

/// What is known at an image that may initialize the pose.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// Rig and camera.
    pub geometry: &'a Geometry,
    /// Configuration of the filter.
    pub config: &'a TightConfig,
    /// Climber at the image.
    pub climber: &'a ClimberAt,
    /// Constants as a former pose knew them.
    pub calibration: &'a Calibration,
    /// Attitude of the IMU (`world_from_imu`) that is the nearest to the right one.
    pub toward: Option<UnitQuaternion<f64>>,
}

/// Returns the most likely initial state that the image allows; `None` where its markers fit no
/// pose. Markers that fit one but for some millimeters count as noisier than they claim: more
/// images find an error of their places ([`layout_misfit`]).
pub fn start(known: &Known, image: &Image, up: Option<&Up>) -> Option<InitialEstimate> {
    let misfit = match attempt(known, image, up) {
        Ok(start) => return Some(start),
        Err(misfit) => misfit?,
    };
    // A marker that is further off is a false one.
    layout_misfit::sigma(&misfit.offsets)?;
    let noise_factor = misfit.noise_factor();
    let start = attempt(known, &image.with_noise(noise_factor), up).ok()?;
    Some(InitialEstimate { noise_factor, ..start })
}

/// Poses that an image allows.
struct Allowed {
    /// The likeliest first.
    poses: Vec<PlanarPose>,
    world_from_camera: Isometry3<f64>,
    /// Direction in the world that "up" measures.
    up_in_world: Vector3<f64>,
}

impl Allowed {
    /// Returns `None` where the image allows none.
    fn new(known: &Known, image: &Image, up: Option<&Up>) -> Option<Self> {
        let Known { geometry, config, climber, calibration, .. } = *known;
        let world_from_climber = image.rest.join(&climber.values);
        let world_from_camera = world_from_climber * geometry.climber_from_camera;
        let solve =
            |tilt: Option<&TiltPrior>| candidates(geometry, calibration, &image.pixels(), tilt);
        // All candidates of an image are nearly at one place.
        let seen = solve(None).first()?.camera_from_volant;
        let place = (world_from_camera * seen).translation.vector;
        let attachment = world_from_climber * Point3::from(config.pendulum.climber_attachment);
        let up_in_world = up.map_or(Vector3::z(), |up| up.in_world(&(attachment.coords - place)));
        let tilt = up.map(|up| TiltPrior {
            up_in_volant: geometry.volant_from_imu.rotation * up.in_imu,
            up_in_camera: world_from_camera.rotation.inverse() * up_in_world,
            sigma: up.sigma,
        });
        Some(Self { poses: solve(tilt.as_ref()), world_from_camera, up_in_world })
    }

    fn world_from_imu(&self, pose: &PlanarPose, geometry: &Geometry) -> Isometry3<f64> {
        self.world_from_camera * pose.camera_from_volant * geometry.volant_from_imu
    }
}

/// Returns the attitudes that an image allows, the likeliest first.
pub fn attitudes(known: &Known, image: &Image, up: Option<&Up>) -> Vec<Candidate> {
    let Some(allowed) = Allowed::new(known, image, up) else { return Vec::new() };
    let candidate = |pose: &PlanarPose| Candidate {
        world_from_imu: allowed.world_from_imu(pose, known.geometry).rotation,
        variance: pose.covariance.fixed_view::<3, 3>(3, 3).trace(),
        pixel_cost: pose.pixel_cost,
        cost: pose.cost,
    };
    allowed.poses.iter().map(candidate).collect()
}

/// Returns the start from the image, or by how much its markers do not fit together.
fn attempt(
    known: &Known,
    image: &Image,
    up: Option<&Up>,
) -> Result<InitialEstimate, Option<Box<Misfit>>> {
    let Known { geometry, config, climber, calibration, .. } = *known;
    let allowed = Allowed::new(known, image, up).ok_or(None)?;
    let best = match known.toward {
        Some(toward) => allowed.poses.iter().min_by(|a, b| {
            let off = |pose: &PlanarPose| {
                allowed.world_from_imu(pose, geometry).rotation.angle_to(&toward)
            };
            off(a).total_cmp(&off(b))
        }),
        None => allowed.poses.first(),
    };
    let best = best.ok_or(None)?;
    let world_from_imu = allowed.world_from_imu(best, geometry);
    let (position, attitude) = (world_from_imu.translation.vector, world_from_imu.rotation);
    let mut state = unknown(config, climber);
    state.position = position;
    state.attitude = attitude;
    state.time_offset = image.time_offset;
    state.calibration = *calibration;
    let none = ImuReading::default();
    let linear = linearize(&state, geometry, image, &none);
    let found = misfit(&state, geometry, image, &none, &linear);
    if let Some(misfit) = found.filter(|misfit| misfit.squared() > LARGEST_MISFIT) {
        return Err(Some(Box::new(misfit)));
    }
    if best.cost > LARGEST_COST {
        return Err(None);
    }
    // The prior is centered on the image's own solution, so that nothing bends.
    state.set_sigmas(POSITION, &Vector3::repeat(OPEN[0]));
    state.set_sigmas(ATTITUDE, &Vector3::repeat(OPEN[1]));
    if let Some(up) = up {
        // R u is the known direction in the world; ∂(R u)/∂δθ = −[R u]×.
        let (variance, none) = (up.sigma * up.sigma, ByParameter::zeros());
        for axis in 0..2 {
            let v = state.attitude * up.in_imu;
            let h = match axis {
                0 => [(ATTITUDE + 1, v.z), (ATTITUDE + 2, -v.y)],
                _ => [(ATTITUDE, -v.z), (ATTITUDE + 2, v.x)],
            };
            update::scalar(&mut state, &h, allowed.up_in_world[axis] - v[axis], variance, &none);
        }
        // Prior and image together have their minimum at the candidate.
        (state.position, state.attitude) = (position, attitude);
    }
    let (gate, gravity) = (f64::INFINITY, config.gravity);
    let record = markers::update(&mut state, geometry, image, &none, gate, gravity, true);
    (state.position, state.attitude) = (position, attitude);
    (state.climber, state.climber_rate) = (climber.values, climber.rates);
    Ok(InitialEstimate { state, record, noise_factor: 1.0 })
}

/// Returns the poses that an image allows, the likeliest first, with the markers where they are
/// estimated to be. What is not known of their places counts as pixel noise.
pub fn candidates(
    geometry: &Geometry,
    calibration: &Calibration,
    pixels: &Pixels,
    tilt: Option<&TiltPrior>,
) -> Vec<PlanarPose> {
    let layout = calibration.layout(&geometry.markers);
    let solve = |pixels: &Pixels, tilt: Option<&TiltPrior>| {
        planar_pose::candidates(&layout, &geometry.camera, &PerColor(*pixels), tilt)
    };
    let variance = calibration.offset_covariance().trace() / OFFSETS as f64;
    if variance == 0.0 {
        return solve(pixels, tilt);
    }
    let Some(distance) = solve(pixels, None).first().map(|p| p.camera_from_volant.translation.z)
    else {
        return Vec::new();
    };
    let more =
        Matrix2::identity() * variance * (geometry.camera.focal_lengths().x / distance).powi(2);
    solve(&pixels.map(|p| p.map(|(pixel, covariance)| (pixel, covariance + more))), tilt)
}

/// Returns whether four markers reject the pose that `state` is nearest to in favor of the other,
/// mirrored one (Schweighofer and Pinz 2006), which a filter without an IMU may follow.
pub fn is_mirrored(geometry: &Geometry, state: &State, image: &Image) -> bool {
    if image.detected() < 4 {
        return false;
    }
    let found = candidates(geometry, &state.calibration, &image.pixels(), None);
    let [best, others @ ..] = found.as_slice() else { return false };
    let world_from_camera = image.rest.join(&state.climber) * geometry.climber_from_camera;
    let away = |pose: &PlanarPose| {
        let seen = world_from_camera * pose.camera_from_volant * geometry.volant_from_imu;
        seen.rotation.angle_to(&state.attitude)
    };
    let nearer = |other: &&PlanarPose| away(other) < away(best);
    best.cost < LARGEST_COST
        && others.iter().find(nearer).is_some_and(|other| other.cost - best.cost > CLEAR)
}

/// Returns a state with the climber by its encoders and all else unknown as configured,
/// but for the calibration.
pub fn unknown(config: &TightConfig, climber: &ClimberAt) -> State {
    let mut state = State::zero();
    state.climber = climber.values;
    state.climber_rate = climber.rates;
    state.set_sigmas(VELOCITY, &INITIAL_VELOCITY.into());
    state.set_sigmas(ACCELEROMETER_BIAS, &Vector3::repeat(config.imu.accelerometer_bias));
    state.set_sigmas(GYROSCOPE_BIAS, &Vector3::repeat(config.imu.gyroscope_bias));
    state.set_sigmas(CLIMBER, &climber.sigmas());
    state.set_sigmas(CLIMBER_RATE, &climber.rate_sigmas);
    state.set_sigmas(CLIMBER_ACCELERATION, &DRIVE_ACCELERATION.into());
    state.set_sigma(TIME_OFFSET, config.clock.camera_sigma.min(LINEAR_OFFSET));
    for axis in 0..3 {
        let by = by_parameter(axis, climber.values[axis], climber.rates[axis]);
        state.sensitivity.set_column(CLIMBER + axis, &by.map(|x| -x as f32));
    }
    state
}

/// An error of the time offset up to which the filter is linear, s (1 sigma). A larger one is found
/// by the alignment ([`super::time_offset`]), and widens the published covariance until then.
const LINEAR_OFFSET: f64 = 0.006;

/// Initial velocity of the platform, each axis, m/s (1 sigma): the fastest swing in a room.
pub const INITIAL_VELOCITY: [f64; 3] = [1.5, 1.5, 1.5];
