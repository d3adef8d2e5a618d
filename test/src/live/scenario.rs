//! What happens in a run: how the rig moves, what its sensors are like, when a marker is covered.

use anyhow::{Context, Result};
use nalgebra::Vector2;
use rig_model::{CameraModel, Distortion, MarkerColor, Rig};
use rig_simulator::{
    Covers, Instant, RIG_YAML, SceneConfig,
    inertial::{SensorConfig, Sensors},
    motion::{Motion, MotionConfig},
};
use std::sync::Arc;

/// Shutter open, s.
pub const EXPOSURE: f64 = 0.005;
/// Images per second.
pub const IMAGE_RATE: f64 = 30.0;

/// A plank over a marker for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cover {
    pub color: MarkerColor,
    /// First and last instant at which nothing of it is seen, s.
    pub seconds: [f64; 2],
}

/// A run, fixed by a seed. Times count from the start of the platform's swing, s.
#[derive(Clone, Debug)]
pub struct Scenario {
    pub rig: Rig,
    pub camera: CameraModel,
    /// Motion of the rig; stationary before zero.
    pub motion: Arc<Motion>,
    /// Biases and noise of the sensors.
    pub sensors: SensorConfig,
    pub scene: SceneConfig,
    pub covers: Vec<Cover>,
}

/// The plank takes so long to slide in or out, s.
const SLIDE: f64 = 0.3;

impl Scenario {
    /// A swing of `duration` seconds with one marker covered for a while in its middle.
    pub fn swing(seed: u64, duration: f64) -> Result<Self> {
        Self::new(MotionConfig { duration, still_until: 0.0, ..MotionConfig::nominal(seed) })
    }

    /// A swing of `duration` seconds that ends stationary where it began, to be repeated.
    pub fn lap(seed: u64, duration: f64) -> Result<Self> {
        // Each lap's end must not be a dash that no crane can drive.
        let motion = MotionConfig {
            duration,
            still_until: 0.0,
            still_from: duration,
            ramp: duration / 4.0,
            ..MotionConfig::nominal(seed)
        };
        Ok(Self { covers: Vec::new(), ..Self::new(motion)? })
    }

    /// The run of this motion, with the usual rig, lens and sensors.
    pub fn new(motion: MotionConfig) -> Result<Self> {
        let lens = Distortion::PlumbBob([-0.229_544, 0.082_09, 0.000_69, -0.000_372, -0.006_257]);
        let (seed, duration) = (motion.seed, motion.duration);
        let colors = MarkerColor::ALL;
        Ok(Self {
            rig: Rig::from_yaml(RIG_YAML).context("the simulated rig's rig file")?,
            camera: CameraModel::new(640, 480, [591.322, 589.677, 319.275, 235.227], lens)
                .context("the simulated rig's lens")?,
            motion: Arc::new(Motion::new(motion)),
            sensors: SensorConfig::nominal(seed),
            scene: SceneConfig { seed, ..SceneConfig::default() },
            covers: vec![Cover {
                color: colors[seed as usize % 4],
                seconds: [0.45 * duration, 0.45 * duration + (0.15 * duration).min(3.0)],
            }],
        })
    }

    /// The rig file with the height of the climber, for all nodes.
    pub fn rig_file(&self) -> String {
        let height = self.motion.config().climber_height;
        format!("{RIG_YAML}\n/**/climber_driver:\n  ros__parameters:\n    height: {height:?}\n")
    }

    pub fn simulated_sensors(&self) -> Sensors<'_> {
        Sensors::new(&self.motion, &self.rig, &self.camera, &self.sensors)
    }

    /// Seconds that the run takes.
    pub fn duration(&self) -> f64 {
        self.motion.duration()
    }

    pub fn instant(&self, t: f64) -> Instant {
        Instant {
            world_from_climber: self.motion.world_from_climber(t),
            world_from_volant: self.motion.world_from_volant(t),
        }
    }

    /// True centroid of a marker in the image at `t`, px; `None` where the camera cannot project
    /// it.
    pub fn true_centroid(&self, color: MarkerColor, t: f64) -> Option<Vector2<f64>> {
        let camera = self.motion.world_from_camera(t, &self.rig);
        let pose = camera.inverse() * self.motion.world_from_volant(t);
        Some(self.rig.markers.projected_centroid(color, &self.camera, &pose)?.pixel)
    }

    /// How far the planks are in at `t`.
    pub fn covers_at(&self, t: f64) -> Covers {
        let mut covers = Covers::default();
        for cover in &self.covers {
            let rise = (t - cover.seconds[0]) / SLIDE + 1.0;
            let fall = (cover.seconds[1] - t) / SLIDE + 1.0;
            covers[cover.color] = f64::max(covers[cover.color], rise.min(fall).clamp(0.0, 1.0));
        }
        covers
    }
}
