//! A unit that is not there: an MTx (or a newer one) that behaves as the manual says, for tests and for the demo.
//!
//! [`FakeUnit`] is the pure model: bytes from the host and the time in, bytes to the host out, each with the instant at
//! which its last bit is on the wire. [`pty::PtyUnit`] puts it behind a pseudo-terminal, in real time.
//!
//! No frame of a real MTx is public: its stream is built here from the manual and from two frames of its sister, the
//! MTi-G.

mod model;
#[cfg(feature = "fake")]
pub mod pty;
mod replies;

pub use model::{FakeUnit, Line, SentSample};

use crate::protocol::{Configuration, DeviceId, LegacyFormat, OutputEntry};
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::Stamp;

/// What the unit feels at one instant, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FakeSample {
    /// Specific force, m/s²: +9.81 up at rest.
    pub specific_force: Vector3<f64>,
    /// Rate of turn, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Its attitude, east-north-up from its axes (a legacy unit sends it against north-west-up; the model turns it).
    pub enu_from_imu: UnitQuaternion<f64>,
    /// Magnetic field, the Earth's being 1.
    pub magnetic_field: Vector3<f64>,
    /// °C.
    pub temperature: f64,
}

impl FakeSample {
    /// Level, at rest.
    pub fn at_rest() -> Self {
        Self {
            specific_force: Vector3::new(0.0, 0.0, 9.81),
            angular_velocity: Vector3::zeros(),
            enu_from_imu: UnitQuaternion::identity(),
            magnetic_field: Vector3::new(0.4, 0.0, -0.9),
            temperature: 25.0,
        }
    }
}

/// Where the samples come from: called once per sample, in the order of time, with the instant (host clock) at which
/// the unit measures.
pub type Source = Box<dyn FnMut(Stamp) -> FakeSample + Send>;

/// What the unit is and what stands in its flash.
#[derive(Clone, Debug)]
pub struct FakeUnitConfig {
    /// Device identifier; the family is in it.
    pub device_id: DeviceId,
    /// Product code.
    pub product_code: String,
    /// Firmware revision.
    pub firmware: [u8; 3],
    /// Baud rate in flash.
    pub baud: u32,
    /// A unit from before 2008: it does not hear a host that sends one stop bit.
    pub needs_two_stop_bits: bool,
    /// Sampling period in flash, ticks of 1/115200 s.
    pub period: u16,
    /// Skip factor in flash.
    pub skip: u16,
    /// Output format in flash.
    pub format: LegacyFormat,
    /// A newer unit's output configuration; `None` makes it a legacy one.
    pub outputs: Option<Vec<OutputEntry>>,
    /// Counter of the first message.
    pub first_counter: u16,
    /// By how much the unit's clock runs fast, parts per million.
    pub clock_ppm: f64,
    /// From a sample to the start of its message on the line, s.
    pub processing: f64,
    /// How long an acknowledgement takes, s.
    pub ack_delay: f64,
    /// How long the acknowledgement of GoToConfig takes, s (the manual's unit: 0.1 to 0.2).
    pub config_ack_delay: f64,
    /// From power-up to WakeUp, s.
    pub boot: f64,
    /// The adapter hands bytes over only every so many seconds (0.016 for a common USB one).
    pub burst: Option<f64>,
    /// How irregular the adapter's periods are, s: each is longer by up to this.
    pub burst_jitter: f64,
    /// So many requests are swallowed before the first is answered.
    pub deaf_to: u32,
    /// The unit is already measuring (it was powered up long ago); otherwise it boots at the start.
    pub already_measuring: bool,
}

impl Default for FakeUnitConfig {
    /// An MTx out of the box: 115200 baud, 100 Hz, calibrated data and quaternion, but **no** counter, so that a driver
    /// has something to set.
    fn default() -> Self {
        let mut format = LegacyFormat::STANDARD;
        format.settings.0 = 0;
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
            processing: 0.0,
            ack_delay: 0.002,
            config_ack_delay: 0.1,
            boot: 0.2,
            burst: None,
            burst_jitter: 0.0,
            deaf_to: 0,
            already_measuring: true,
        }
    }
}

impl FakeUnitConfig {
    /// The Configuration message's content.
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
