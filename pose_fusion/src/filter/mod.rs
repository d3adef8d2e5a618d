//! Tightly coupled error-state filter. Inputs (`ingest`) go to their place on the time line, which
//! is processed up to its end (`processing`); the newest state is published (`publish`). An image
//! initializes the pose (`starting`) with the camera's time offset (`time_offset`). The parts are
//! values of their own: this type only connects them.

mod encoders;
mod ingest;
mod operator;
mod processing;
mod publish;
mod readiness;
mod reweighing;
mod starting;
mod time_offset;

use crate::{
    adaptation::{disturbances::Disturbances, images::ImageAdaptation},
    config::{StatusConfig, TightConfig},
    ekf::{consider::Uncertainty, state::State},
    health::{
        contradiction_monitor::ContradictionMonitor,
        encoder_trust::EncoderTrust,
        rig_evidence::RigEvidence,
        status::{EncoderStatus, Status, TimeOffsetStatus},
    },
    initialization::time_offset::TimeOffsetSearch,
    input::{climber_track::ClimberTrack, imu::ImuInput},
    measurements::geometry::Geometry,
    timeline::{arrival::Arrival, history::History},
};
use publish::Publisher;
use rig_model::{CameraModel, Rig};
use starting::Start;

/// Error-state filter.
#[derive(Clone, Debug)]
pub struct Filter {
    setup: Setup,
    arrival: Arrival,
    history: History,
    imu: ImuInput,
    images: ImageAdaptation,
    climber: ClimberTrack,
    disturbances: Disturbances,
    trust: EncoderTrust,
    evidence: RigEvidence,
    monitor: ContradictionMonitor,
    search: Option<TimeOffsetSearch>,
    start: Start,
    publisher: Publisher,
}

/// What is given: rig, configuration and camera.
#[derive(Clone, Debug)]
struct Setup {
    rig: Rig,
    config: TightConfig,
    status: StatusConfig,
    geometry: Option<Geometry>,
    /// Sigmas of what the rig file says.
    calibration: Uncertainty,
    frozen: bool,
    /// Configured time offset of the camera with the steps of the clocks since, s.
    camera_offset: f64,
    /// The same after a step that a frozen filter does not follow yet, s.
    stepped: Option<f64>,
}

impl Filter {
    /// Creates a filter without an estimate.
    pub fn new(rig: Rig, config: TightConfig, status: StatusConfig) -> Self {
        let setup = Setup {
            camera_offset: config.clock.camera_offset,
            calibration: Uncertainty::new(&config.calibration, &rig.markers),
            rig,
            config,
            status,
            geometry: None,
            frozen: false,
            stepped: None,
        };
        let config = &setup.config;
        Self {
            arrival: Arrival::default(),
            history: History::default(),
            imu: ImuInput::default(),
            images: ImageAdaptation::default(),
            climber: ClimberTrack::new(&config.climber),
            disturbances: Disturbances::default(),
            trust: EncoderTrust::default(),
            evidence: RigEvidence::default(),
            monitor: ContradictionMonitor::default(),
            search: search(config),
            start: Start::default(),
            publisher: Publisher::new(),
            setup,
        }
    }

    /// Sets the camera's calibration; a changed one counts from the next image on.
    fn camera(&mut self, camera: &CameraModel) {
        if self.setup.geometry.as_ref().is_none_or(|g| g.camera != *camera) {
            let geometry = Geometry::new(&self.setup.rig, camera.clone());
            let readout = self.setup.config.clock.image_readout;
            self.setup.geometry = Some(Geometry { readout, ..geometry });
            self.evidence = RigEvidence::default();
        }
    }

    /// Stops or resumes using markers; what is not used is still compared and recorded.
    pub fn freeze(&mut self, frozen: bool) {
        self.setup.frozen = frozen;
        self.follow_clock_step();
    }

    /// Takes the clocks to differ by the configured offset again.
    pub fn forget_clock_steps(&mut self) {
        self.setup.camera_offset = self.setup.config.clock.camera_offset;
        self.setup.stepped = None;
    }

    /// Discards the estimate and everything identified; the next image initializes it. Counters,
    /// camera, steps of the clocks and whether the IMU samples come in bursts stay.
    pub fn reset(&mut self) {
        self.archive_until(None);
        let setup = self.setup.clone();
        let mut fresh = Self::new(setup.rig.clone(), setup.config.clone(), setup.status.clone());
        fresh.setup = setup;
        self.imu.keep_stamps_only();
        fresh.imu = std::mem::take(&mut self.imu);
        self.publisher.counts.inputs.overflows += self.history.overflows;
        fresh.publisher.keep_from(&mut self.publisher);
        *self = fresh;
    }

    /// Returns whether there is a pose.
    pub(super) fn is_started(&self) -> bool {
        self.history.processed() > 0
    }

    /// Returns the newest state, once initialized.
    pub fn state(&self) -> Option<&State> {
        self.history.newest_processed().map(|entry| &entry.state)
    }

    /// Returns counters and the newest insights.
    pub fn status(&self) -> Status {
        let (config, imu) = (&self.setup.config, &self.setup.rig.imu);
        let geometry = self.setup.geometry.as_ref();
        let mut status = Status {
            initialized: self.is_started(),
            encoders: EncoderStatus {
                suspended: self.trust.is_suspended(),
                wrong_directions: self.trust.directions.wrong(),
            },
            newest_imu: self.arrival.newest_imu().map(|(stamp, _)| stamp),
            imu_noise: self.imu.densities(imu),
            imu_bursts: self.imu.stamps.bursts,
            position_sigma: f64::INFINITY,
            time_offset: TimeOffsetStatus {
                offset: self.time_offset(),
                configured: config.clock.camera_offset,
                sigma: config.clock.camera_sigma,
                searching: self.search.is_some(),
            },
            pixel_noise_factor: self.images.pixel_noise.factor.sqrt(),
            file_errors: self.evidence.wrong,
            rope: geometry.and_then(|g| self.images.rope.rope(&config.pendulum, g)),
            counts: self.publisher.counts,
            ..Status::default()
        };
        status.counts.inputs.overflows += self.history.overflows;
        if let Some(state) = self.state() {
            status.time_offset.sigma =
                state.sigma(crate::ekf::state::TIME_OFFSET).hypot(self.offset_doubt());
            status.biases = [state.accelerometer_bias, state.gyroscope_bias];
            status.constants = state.calibration.constants();
            status.position_sigma = self.publisher.position_sigma;
        }
        status
    }
}

/// Returns a search for the camera time offset, unless the configuration knows it.
fn search(config: &TightConfig) -> Option<TimeOffsetSearch> {
    (config.clock.camera_sigma > 0.0).then(TimeOffsetSearch::default)
}
