//! Simulated MTx (or MTi-1, 10, 100, 600) that behaves as documented in the manual, for tests and
//! the demo.
//!
//! [`SimulatedImu`] is the pure model: bytes from the host and time → bytes to the host, each with
//! the time of its last bit on the wire. `pty::PtyImu` connects it to a pseudo-terminal in real
//! time.
//!
//! Its frames follow the manual and two recorded frames of an MTi-G, because no recording of an MTx
//! is public.

mod line;
mod model;
#[cfg(feature = "simulated")]
pub mod pty;
mod replies;

pub use line::Line;
pub use model::{SentSample, SimulatedImu};

use crate::protocol::{
    Configuration, DeviceId, LegacyFormat, OutputEntry, OutputSettings,
    configuration::{TICKS_PER_SECOND, message_rate},
};
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::Stamp;

/// True motion and environment of the IMU at one instant, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedSample {
    /// Specific force, m/s²: +9.81 up at rest.
    pub specific_force: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Rotation from the IMU to east-north-up.
    pub enu_from_imu: UnitQuaternion<f64>,
    /// Magnetic field, relative to that of the Earth.
    pub magnetic_field: Vector3<f64>,
    /// Temperature, °C.
    pub temperature: f64,
}

impl SimulatedSample {
    /// Level and stationary.
    pub fn stationary() -> Self {
        Self {
            specific_force: Vector3::new(0.0, 0.0, 9.81),
            angular_velocity: Vector3::zeros(),
            enu_from_imu: UnitQuaternion::identity(),
            magnetic_field: Vector3::new(0.4, 0.0, -0.9),
            temperature: 25.0,
        }
    }
}

/// Source of the samples, called once per sample in the order of time with the time of measurement
/// (host clock).
pub type Source = Box<dyn FnMut(Stamp) -> SimulatedSample + Send>;

/// Identity, flash content and timing of the simulated IMU.
///
/// One field per property that a test varies, hence their number.
#[derive(Clone, Debug)]
pub struct SimulatedImuConfig {
    /// Device identifier, which contains the family.
    pub device_id: DeviceId,
    /// Product code.
    pub product_code: String,
    /// Firmware revision.
    pub firmware: [u8; 3],
    /// Baud rate in flash.
    pub baud: u32,
    /// Ignore a host that sends one stop bit, as an MTx from before 2008.
    pub needs_two_stop_bits: bool,
    /// Sampling period in flash, ticks of 1/115200 s.
    pub period: u16,
    /// Skip factor in flash.
    pub skip: u16,
    /// Output format in flash.
    pub format: LegacyFormat,
    /// Output configuration of an MTi-1, 10, 100, 600; `None`: legacy device. Empty: an MTi-10 or
    /// 100 that sends legacy messages.
    pub outputs: Option<Vec<OutputEntry>>,
    /// Counter of the first message.
    pub first_counter: u16,
    /// Clock error of the device, ppm, positive if it is fast.
    pub clock_ppm: f64,
    /// Delay of an acknowledgement, s.
    pub ack_delay: f64,
    /// Delay of the acknowledgement of GoToConfig, s (manual: 0.1 to 0.2).
    pub config_ack_delay: f64,
    /// Time from power-up to WakeUp, s.
    pub boot: f64,
    /// Period at which the adapter forwards bytes, s (0.016 for a common USB adapter).
    pub burst: Option<f64>,
    /// Largest prolongation of a period of the adapter, s.
    pub burst_jitter: f64,
    /// Number of requests ignored before the first answer.
    pub ignored_requests: u32,
    /// The device is measuring at the start; otherwise it boots.
    pub already_measuring: bool,
}

impl Default for SimulatedImuConfig {
    /// An MTx with factory settings: 115200 baud, 100 Hz, calibrated data and quaternion, **no**
    /// counter, which the driver has to set.
    fn default() -> Self {
        let mut format = LegacyFormat::STANDARD;
        format.settings = OutputSettings::empty();
        Self {
            device_id: DeviceId(0x0030_0C7B),
            product_code: "MTx-28A53G25".into(),
            firmware: [2, 6, 0],
            baud: 115_200,
            needs_two_stop_bits: false,
            period: 1152,
            skip: 0,
            format,
            outputs: None,
            first_counter: 0,
            clock_ppm: 0.0,
            ack_delay: 0.002,
            config_ack_delay: 0.1,
            boot: 0.2,
            burst: None,
            burst_jitter: 0.0,
            ignored_requests: 0,
            already_measuring: true,
        }
    }
}

impl SimulatedImuConfig {
    /// Outputs of MTData2; `None` if the device sends legacy messages.
    pub(super) fn mtdata2(&self) -> Option<&[OutputEntry]> {
        self.outputs.as_deref().filter(|outputs| !outputs.is_empty())
    }

    /// Ticks of 1/115200 s between two messages; `None`: on request only.
    pub(super) fn ticks_per_message(&self) -> Option<f64> {
        match self.mtdata2().and_then(message_rate) {
            Some(rate) => Some(TICKS_PER_SECOND / f64::from(rate)),
            None => self.configuration().ticks_per_message().map(f64::from),
        }
    }

    /// Content of the Configuration message.
    pub fn configuration(&self) -> Configuration {
        Configuration {
            device_id: self.device_id,
            period: self.period,
            skip: self.skip,
            data_length: self.format.data_length() as u16,
            format: self.format,
        }
    }
}
