//! ROS 2 node: serial port → `volant/imu/data`, `imu/mag`, `imu/temperature`, `/tf_static`,
//! `/diagnostics`.

use crate::{
    driver::{Driver, DriverConfig, Event, Sample, Severity, Statistics},
    protocol::Status,
    serial::{DriverStatus, Port, Report, Runner},
};
use nalgebra::Matrix3;
use node_kit::{
    Level, convert,
    node::{Health, NodeContext, NodeError, NodeShell, Publisher},
    qos::QosPreset,
};
use rig_model::{Frames, topics};
use volant_msgs::{
    geometry_msgs::msg::Vector3,
    sensor_msgs::msg::{Imu, MagneticField, Temperature},
};

/// Time that all samples may be late before it counts as a clock step, s.
///
/// Steps of the host's clock are reported by the runner; the remaining cases are an overloaded host
/// and a device whose clock jumps without its counter.
const PATIENCE: f64 = 10.0;

node_kit::parameters! {
    /// Parameters of the node: those of the core, and what only the node needs.
    pub struct ImuParameters {
        /// Serial port of the IMU; `volant imu find` lists ports.
        port: String = "/dev/ttyUSB0";
        /// Wait for a port that does not exist at the start, instead of exiting with status 1.
        wait_for_device: bool = false;
        /// Standard deviation of one sample; 0: the rig's noise density times the square root of
        /// the rate.
        accelerometer_stddev: f64 = 0.0, unit("m/s^2"), range(0.0..=100.0), live;
        /// Standard deviation of one sample; 0: the rig's noise density times the square root of
        /// the rate.
        gyroscope_stddev: f64 = 0.0, unit("rad/s"), range(0.0..=100.0), live;
        /// Standard deviation of roll and pitch of the orientation (data sheet, dynamic).
        tilt_stddev: f64 = 0.035,
            unit("rad"), range(0.0..=3.2), name("orientation_stddev.tilt"), live;
        /// Standard deviation of the heading of the orientation.
        heading_stddev: f64 = 0.087,
            unit("rad"), range(0.0..=3.2), name("orientation_stddev.heading"), live;
        /// Tesla per unit of the magnetic field in the messages (about 1 in the Earth's field).
        magnetic_field_scale: f64 = 5e-5, unit("T"), range(0.0..=1.0), live;
        /// Standard deviation of the magnetic field, in the unit of the messages.
        magnetic_field_stddev: f64 = 0.0015, range(0.0..=10.0), live;
        /// Specific force beyond which a sample counts as clipped; 0: status bits only.
        accelerometer_range: f64 = 0.0, unit("m/s^2"), range(0.0..=10000.0), live;
        /// Angular velocity beyond which a sample counts as clipped; 0: status bits only.
        gyroscope_range: f64 = 0.0, unit("rad/s"), range(0.0..=1000.0), live;
        /// Publish volant -> imu on /tf_static; false if robot_state_publisher does.
        publish_static_tf: bool = true;
        groups {
            /// Configuration of the core.
            core: DriverConfig;
        }
    }
}

/// Shell of the node `imu_driver`.
pub struct ImuNode {
    parameters: ImuParameters,
    frames: Frames,
    /// The rig's noise densities, m/s²/√Hz and rad/s/√Hz.
    noise_densities: (f64, f64),
    data: Publisher<Imu>,
    magnetic_field: Publisher<MagneticField>,
    temperature: Publisher<Temperature>,
    status: Option<DriverStatus>,
    before: Statistics,
    /// Number of ticks, one per second, since the last sample.
    idle: u32,
    clipped: u64,
    clipped_before: u64,
    last_error: Option<String>,
}

impl NodeShell for ImuNode {
    const NAME: &'static str = "imu_driver";
    const ABOUT: &'static str = "samples of an Xsens IMU on a serial port";
    type Parameters = ImuParameters;
    type Input = Report;

    fn start(
        context: &mut NodeContext<Report>,
        parameters: ImuParameters,
    ) -> Result<Self, NodeError> {
        let rig = context.rig()?;
        let config = DriverConfig { step_patience: PATIENCE, ..parameters.core.clone() };
        let (first_baud, two_stop_bits) = (config.first_baud(), config.two_stop_bits);
        let driver = Driver::new(config).map_err(NodeError::shell)?;
        let data = context.advertise(topics::IMU, QosPreset::Sensor)?;
        let magnetic_field = context.advertise("imu/mag", QosPreset::Sensor)?;
        let temperature = context.advertise("imu/temperature", QosPreset::Sensor)?;
        let opened = match Port::open(&parameters.port, first_baud, two_stop_bits) {
            Ok(port) => Some(port),
            Err(_) if parameters.wait_for_device => None,
            Err(error) => {
                return Err(NodeError::shell(format!(
                    "{error}; set wait_for_device: true to wait for it"
                )));
            }
        };
        if parameters.publish_static_tf {
            let transform = convert::transform_message(
                &rig.frames.volant,
                &rig.frames.imu,
                context.now(),
                &rig.imu.volant_from_imu,
            );
            context.send_static_transform(transform)?;
        }
        let sender = context.device_sender(&parameters.port, 1024);
        let clock = context.clock();
        let runner = Runner { port: parameters.port.clone(), driver, raw: false, opened };
        context.spawn("imu-serial", move || {
            let alive = sender.clone();
            let mut watch = clock.watch();
            runner.run(
                || clock.now(),
                || watch.set_by(),
                |report| sender.send(report),
                || alive.is_open(),
            );
        })?;
        Ok(Self {
            frames: rig.frames,
            noise_densities: (rig.imu.accelerometer_noise_density, rig.imu.gyroscope_noise_density),
            data,
            magnetic_field,
            temperature,
            status: None,
            before: Statistics::default(),
            idle: 0,
            clipped: 0,
            clipped_before: 0,
            last_error: None,
            parameters,
        })
    }

    fn handle(&mut self, context: &mut NodeContext<Report>, input: Report) {
        match input {
            Report::Sample(sample) => self.publish(sample),
            Report::Event(event) => self.report(context, &event),
            Report::Status(status) => self.status = Some(*status),
            Report::Bytes(_) => {}
        }
    }

    fn tick(&mut self, context: &mut NodeContext<Report>) {
        let port = self.parameters.port.clone();
        let Some(status) = &self.status else {
            context.diagnose("imu", Health::Warn, "starting", &[("port", port)]);
            return;
        };
        let now = status.statistics;
        let before = std::mem::replace(&mut self.before, now);
        self.idle = if now.samples == before.samples { self.idle + 1 } else { 0 };
        let lost = now.lost - before.lost;
        let checksums = now.parser.bad_checksums - before.parser.bad_checksums;
        let skipped = now.parser.skipped_bytes - before.parser.skipped_bytes;
        let clipped = self.clipped - std::mem::replace(&mut self.clipped_before, self.clipped);
        let self_test = now.status.map(|s| s.contains(Status::SELF_TEST_PASSED));
        let warn = |text: &str| (Health::Warn, text.to_owned());
        let (health, message) = if !status.measuring {
            (Health::Error, self.last_error.clone().unwrap_or_else(|| status.state.to_owned()))
        } else if self_test == Some(false) {
            (Health::Error, "the self-test of the IMU failed: have it repaired".to_owned())
        } else if is_silent(self.idle, now.rate) {
            let reason = || format!("no samples in the last {} s", self.idle);
            (Health::Error, self.last_error.clone().unwrap_or_else(reason))
        } else if before.connections > 0 && now.connections > before.connections {
            warn("the IMU was silent or restarted in the last second and was set up again")
        } else if lost > 0 {
            warn(&format!("{lost} samples lost in the last second"))
        } else if checksums > 0 {
            warn(&format!("{checksums} checksum errors in the last second: check the cable"))
        } else if skipped > 0 {
            let text = "bytes in the last second belonged to no message: check the cable";
            warn(&format!("{skipped} {text}"))
        } else if now.drift_exceeded {
            warn(
                "the clocks of IMU and host drift too fast for the clock fit: stamps are wrong; \
                 see the log",
            )
        } else if clipped > 0 {
            warn(&format!("{clipped} samples clipped in the last second"))
        } else {
            (Health::Ok, "samples are published".to_owned())
        };
        let identity = &status.identity;
        let mut values = vec![
            ("port", port),
            ("state", status.state.to_owned()),
            ("baud", identity.baud.to_string()),
            ("device id", identity.device_id.to_string()),
            ("product", identity.product_code.clone()),
            ("firmware", identity.firmware.clone()),
            ("configured rate", format!("{:.3}", now.rate)),
            ("samples", now.samples.to_string()),
            ("samples in the last second", (now.samples - before.samples).to_string()),
            ("lost samples", now.lost.to_string()),
            ("repeated samples", now.repeated.to_string()),
            ("checksum errors", now.parser.bad_checksums.to_string()),
            ("skipped bytes", now.parser.skipped_bytes.to_string()),
            ("unreadable messages", now.unreadable.to_string()),
            ("clipped samples", self.clipped.to_string()),
            ("connections", now.connections.to_string()),
            ("low latency", status.low_latency.to_string()),
        ];
        if let Some(passed) = self_test {
            values.push(("self-test", if passed { "passed" } else { "failed" }.to_owned()));
        }
        if let Some(ppm) = now.drift_ppm {
            values.push(("clock drift, ppm", format!("{ppm:.1}")));
        }
        context.diagnose("imu", health, &message, &values);
    }

    fn parameters_changed(
        &mut self,
        _context: &mut NodeContext<Report>,
        parameters: &ImuParameters,
    ) -> Result<(), String> {
        self.parameters = parameters.clone();
        Ok(())
    }
}

/// Whether a device of this rate, Hz, should have sent within `idle` seconds: two samples of a slow
/// one.
fn is_silent(idle: u32, rate: f64) -> bool {
    f64::from(idle) * rate >= 2.0
}

fn exceeds(range: f64, v: &nalgebra::Vector3<f64>) -> bool {
    range > 0.0 && v.amax() >= range
}

impl ImuNode {
    fn publish(&mut self, sample: Sample) {
        let p = &self.parameters;
        let by_status = sample.status.is_some_and(|s| s.intersects(Status::CLIPPING));
        let by_range = sample.imu.as_ref().is_some_and(|imu| {
            exceeds(p.accelerometer_range, &imu.specific_force)
                || exceeds(p.gyroscope_range, &imu.angular_velocity)
        });
        self.clipped += u64::from(by_status || by_range);
        if let Some(mut imu) = sample.imu {
            if let Some(orientation) = &mut imu.orientation {
                let (tilt, heading) =
                    (p.tilt_stddev * p.tilt_stddev, p.heading_stddev * p.heading_stddev);
                let diagonal = nalgebra::Vector3::new(tilt, tilt, heading);
                orientation.covariance = Some(Matrix3::from_diagonal(&diagonal));
            }
            // The device's rate, Hz: its settings may have been left as they are.
            let device_rate = self.status.as_ref().map(|s| s.statistics.rate);
            let rate = device_rate.filter(|rate| *rate > 0.0).unwrap_or(p.core.rate);
            let variance = |stddev: f64, density: f64| {
                let v = if stddev > 0.0 { stddev * stddev } else { density * density * rate };
                (v > 0.0).then_some(v)
            };
            self.data.publish(convert::imu_message(
                &self.frames.imu,
                &imu,
                variance(p.accelerometer_stddev, self.noise_densities.0),
                variance(p.gyroscope_stddev, self.noise_densities.1),
            ));
        }
        let header = || convert::header(&self.frames.imu, sample.stamp);
        if let Some(field) = sample.magnetic_field {
            let tesla = field * p.magnetic_field_scale;
            let v = (p.magnetic_field_stddev * p.magnetic_field_scale).powi(2);
            self.magnetic_field.publish(MagneticField {
                header: header(),
                magnetic_field: Vector3 { x: tesla.x, y: tesla.y, z: tesla.z },
                magnetic_field_covariance: [v, 0.0, 0.0, 0.0, v, 0.0, 0.0, 0.0, v],
            });
        }
        if let Some(temperature) = sample.temperature {
            self.temperature.publish(Temperature { header: header(), temperature, variance: 0.0 });
        }
    }

    fn report(&mut self, context: &mut NodeContext<Report>, event: &Event) {
        let level = match event.severity() {
            Severity::Info => Level::Info,
            Severity::Warning => Level::Warn,
            Severity::Error => Level::Error,
        };
        let line = format!("{}: {event}", self.parameters.port);
        match event {
            Event::Measuring(_) => self.last_error = None,
            _ if level >= Level::Error => self.last_error = Some(event.to_string()),
            _ => {}
        }
        // Events that may occur many times per second are throttled; the diagnostics count them.
        let key: &str = match event {
            Event::Lost(_) => "lost",
            Event::DeviceFault(_) => "fault",
            Event::ClockSet(_) | Event::ClockStepped(_) | Event::DeviceRestarted => "clock",
            Event::DriftExceeded => "drift",
            // Repeated with every attempt to start a device that does not measure.
            Event::Silent(_) => "silent",
            Event::Found(_)
            | Event::Measuring(_)
            | Event::Rejected { .. }
            | Event::Unanswered(_) => &line,
            _ => return context.log(level, line),
        };
        context.log_throttled(level, key, &line);
    }
}

#[cfg(test)]
mod tests {
    use super::is_silent;

    #[test]
    fn a_slow_rate_is_no_silence() {
        let silent = |rate| [1, 3, 4].map(|idle| is_silent(idle, rate));
        assert_eq!(silent(100.0), [true; 3]);
        assert_eq!(silent(0.5), [false, false, true]);
        assert_eq!(silent(0.0), [false; 3]);
    }
}
