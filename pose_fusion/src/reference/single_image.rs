//! Pose from one image alone, by the paper's section II-E and eq. 4 (`volant/visual_pose`).
//!
//! The markers' centroids give the pose in the camera's frame; the encoders, interpolated to the
//! image's stamp, and the camera's mounting bring it to the world (eq. 4). With two or more markers
//! hidden there is none. The published filter has the published pose
//! ([`crate::reference::published_pose`]). Else all poses that the image allows are found
//! ([`rig_model::planar_pose`]); the previous visual pose chooses between them, or with
//! `visual_pose.use_gravity` the IMU's direction of "up"; the pixels alone place the chosen one.

use crate::{
    config::{FusionConfig, Model},
    input::{climber_track::ClimberTrack, imu::VerticalReferences, markers::is_usable},
    measurements::geometry::ClimberHeightTilt,
    output::PoseEstimate,
    reference::{marker_measurement::SightLine, published_pose::published_pose},
};
use nalgebra::{Isometry3, Matrix2, Matrix6, Point3, Vector3, Vector6};
use rig_model::{
    CameraModel, ClimberSample, MarkerObservation, MarkerObservations, MarkerState, PerColor, Rig,
    Sample, Stamp,
    planar_pose::{self, MarkerPixels, PlanarPose},
};

/// Encoder readings further from the image than this do not serve it, s.
const ENCODERS_NEAR: f64 = 0.1;
/// Smallest uncertainty of the IMU's own roll and pitch, rad.
const ATTITUDE_FLOOR: f64 = 1e-3;
/// Expected sum of the squared residuals of four markers at the best pose (χ², 2 degrees of
/// freedom), and the multiple of it (0.999 quantile) above which a marker is false.
const FREEDOM: f64 = 2.0;
const LARGE_MISFIT: f64 = 6.9;
/// The previous visual pose decides for this long, s, with this uncertainty of the rotation, rad.
const PREVIOUS: [f64; 2] = [0.3, 0.2];

/// Pose from one image, and what eq. 8 needs of it.
#[derive(Clone, Debug)]
pub struct Visual {
    /// `world_from_volant`.
    pub pose: PoseEstimate,
    /// Lines from the camera through the markers that were used, world.
    pub lines: PerColor<Option<SightLine>>,
}

impl Visual {
    /// Returns the number of markers that were used.
    pub fn markers(&self) -> u8 {
        self.lines.0.iter().flatten().count() as u8
    }
}

/// Poses from single images.
#[derive(Debug)]
pub struct SingleImagePose {
    rig: Rig,
    camera: Option<CameraModel>,
    verticals: VerticalReferences,
    climber: ClimberTrack,
    /// `world_from_volant` of the newest visual pose.
    last: Option<(Stamp, Isometry3<f64>)>,
    config: FusionConfig,
}

impl SingleImagePose {
    /// Creates an estimator for a rig, with `model: paper` of the published pose.
    pub fn new(rig: Rig, config: &FusionConfig) -> Self {
        Self {
            rig,
            camera: None,
            verticals: VerticalReferences::default(),
            climber: ClimberTrack::new(&config.tight.climber),
            last: None,
            config: config.clone(),
        }
    }

    /// Discards everything but the camera.
    pub fn reset(&mut self) {
        self.verticals = VerticalReferences::default();
        self.climber = ClimberTrack::new(&self.config.tight.climber);
        self.last = None;
    }

    /// Takes in one input; of an image returns the pose.
    pub fn handle(&mut self, input: &Sample) -> Option<Visual> {
        match input {
            Sample::Imu(sample) => {
                if self.config.visual_use_gravity && self.config.model == Model::Tight {
                    self.verticals.add(sample, ATTITUDE_FLOOR);
                }
            }
            Sample::Markers(markers) => return self.estimate(markers),
            Sample::Climber(sample) => self.climber(sample),
            Sample::Camera(camera) => self.camera = Some(camera.clone()),
        }
        None
    }

    /// Takes in an encoder reading.
    fn climber(&mut self, sample: &ClimberSample) {
        let split = ClimberHeightTilt::split(&sample.world_from_climber);
        let Some((values, rest)) = split else { return };
        // A looped bag starts again.
        let ahead = self.climber.newest().map(|(newest, ..)| newest.seconds_since(sample.stamp));
        if ahead.is_some_and(|ahead| ahead > 1.0) {
            self.reset();
        }
        self.climber.add(sample.stamp, values, rest);
    }

    /// Returns `world_from_volant` from one image. `None` with fewer than three detected markers,
    /// or without encoder readings within 0.1 s.
    fn estimate(&mut self, observations: &MarkerObservations) -> Option<Visual> {
        let camera = self.camera.as_ref()?;
        let stamp = observations.stamp;
        let pixels = self.pixels(observations)?;
        let (world_from_climber, climber_sigma) = self.climber_at(stamp)?;
        let world_from_camera = world_from_climber * self.rig.climber_from_camera;
        // A false marker may put the platform anywhere.
        let farthest = self.config.tight.limits.max_range;
        let within = |c: &PlanarPose| c.camera_from_volant.translation.vector.norm() < farthest;
        let last = self.last.filter(|(last, _)| stamp.seconds_since(*last).abs() < PREVIOUS[0]);
        let found = if self.config.model == Model::Paper {
            let before = last.map(|(_, pose)| world_from_camera.inverse() * pose);
            published_pose(&self.rig.markers, camera, &pixels, before.as_ref()).filter(within)?
        } else {
            let mut found = planar_pose::candidates(&self.rig.markers, camera, &pixels, None);
            found.retain(within);
            let up = self.verticals.at(stamp.plus_seconds(self.config.tight.clock.camera_offset));
            let cost = |c: &PlanarPose| {
                let rotation = (world_from_camera * c.camera_from_volant).rotation;
                let unlikely = match (up, last) {
                    (Some(up), _) => {
                        let measured = rotation * self.rig.imu.volant_from_imu.rotation * up.in_imu;
                        measured.angle(&Vector3::z()) / up.sigma
                    }
                    (None, Some((_, last))) => rotation.angle_to(&last.rotation) / PREVIOUS[1],
                    _ => 0.0,
                };
                c.cost + unlikely * unlikely
            };
            *found.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?
        };
        let pose = world_from_camera * found.camera_from_volant;
        self.last = Some((stamp, pose));
        let turn = world_from_camera.rotation.to_rotation_matrix();
        let mut jacobian = Matrix6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
        // Markers that do not fit together are not where they seem to be.
        let misfit = found.pixel_cost / FREEDOM;
        let unlikely = if misfit > LARGE_MISFIT { misfit } else { 1.0 };
        let mut covariance = jacobian * found.covariance * jacobian.transpose() * unlikely;
        let [place, angle] = climber_sigma.map(|s| s * s);
        covariance[(0, 0)] += place;
        covariance[(1, 1)] += place;
        let arm = pose.translation.vector - world_from_climber.translation.vector;
        let by_turn = Vector6::new(-arm.y, arm.x, 0.0, 0.0, 0.0, 1.0);
        covariance += by_turn * by_turn.transpose() * angle;
        let covariance = (covariance + covariance.transpose()) * 0.5;
        let origin = Point3::from(world_from_camera.translation.vector);
        let lines = pixels.0.map(|pixel| {
            Some(SightLine { origin, direction: world_from_camera * camera.ray(&pixel?.0)? })
        });
        Some(Visual { pose: PoseEstimate { stamp, pose, covariance }, lines: PerColor(lines) })
    }

    /// Pixels of the markers that serve a pose, with covariances; `None` with fewer than three.
    fn pixels(&self, observations: &MarkerObservations) -> Option<MarkerPixels> {
        let count = |state: MarkerState| {
            let usable = |m: &&MarkerObservation| m.state == state && is_usable(m);
            observations.markers.0.iter().filter(usable).count()
        };
        if count(MarkerState::Detected) < 3 {
            return None;
        }
        // One hidden marker may be placed by the flow of the others (eq. 3), with its covariance.
        let with_predicted = count(MarkerState::Predicted) == 1;
        let floor = self.config.tight.markers.pixel_floor;
        let floor = Matrix2::identity() * (floor * floor + 1e-4);
        Some(PerColor::from_fn(|color| {
            let m = &observations.markers[color];
            let take = m.state == MarkerState::Detected
                || (with_predicted && m.state == MarkerState::Predicted);
            (take && is_usable(m)).then(|| (m.centroid, m.covariance + floor))
        }))
    }

    /// `world_from_climber` at an image's stamp, with the sigmas of place (m) and turn (rad).
    fn climber_at(&self, stamp: Stamp) -> Option<(Isometry3<f64>, [f64; 2])> {
        let read = stamp.plus_seconds(-self.config.tight.clock.climber_offset);
        let at = self.climber.at(read).filter(|at| at.distance < ENCODERS_NEAR)?;
        let sigma = |axis: usize| at.noise[axis].hypot(at.growth[axis]);
        Some((at.rest.join(&at.values), [sigma(0).max(sigma(1)), sigma(2)]))
    }
}
