//! The shell: a serial port in; `volant/imu/data`, `imu/mag`, `imu/temperature`, `/tf_static` and diagnostics out.

use crate::{
    clock_fit::ClockFitConfig,
    driver::{Driver, DriverConfig, Event, Sample, Severity, Statistics},
    protocol::{NumberFormat, Status},
    serial::{DriverStatus, Port, Report, Runner},
};
use nalgebra::Matrix3;
use node_kit::{
    Level, convert,
    node::{Health, Kit, NodeError, NodeShell, Publisher},
    qos::QosPreset,
};
use rig_model::Frames;
use volant_msgs::{
    geometry_msgs::msg::Vector3,
    sensor_msgs::msg::{Imu, MagneticField, Temperature},
};

/// So long all samples may be late before the clocks count as apart, s. When the host's is set the runner tells; what is left is a
/// unit whose clock jumped without its counter showing it, which hardly can be, and a computer on which nothing runs in time.
const PATIENCE: f64 = 10.0;

node_kit::parameters! {
    /// Parameters of the inertial unit's node.
    pub struct ImuParameters {
        /// Serial port of the unit; `volant imu find` lists them.
        port: String = "/dev/ttyUSB0";
        /// Baud rate; 0 looks for the unit at the usual ones.
        baud: u32 = 115200, range(0..=4000000);
        /// Keep looking for a port that is not there at the start, instead of ending with status 1.
        wait_for_device: bool = false;
        /// Send two stop bits: an MTx from before 2008 hears nothing else.
        two_stop_bits: bool = false;
        /// Samples per second.
        rate: f64 = 100.0, unit("Hz"), range(0.01..=512.0);
        /// Take the unit's own orientation.
        orientation: bool = true, name("outputs.orientation");
        /// Take the magnetic field and publish imu/mag.
        magnetic_field: bool = true, name("outputs.magnetic_field");
        /// Take the temperature and publish imu/temperature.
        temperature: bool = false, name("outputs.temperature");
        /// Take the status bits: self-test, filter, clipping.
        status: bool = false, name("outputs.status");
        /// How the unit writes numbers: float32, fp12.20, fp16.32 or double.
        number_format: String = "float32", name("outputs.number_format");
        /// Change nothing in the unit: take its settings as they are.
        leave_settings: bool = false;
        /// From a sample to the arrival of its last bit; negative: the time that the bytes take at the baud rate.
        transmission_delay: f64 = -1.0, unit("s"), range(-1.0..=1.0);
        /// The longest pause between two attempts to find the unit again.
        longest_pause: f64 = 1.0, unit("s"), range(0.1..=60.0);
        /// Standard deviation of one reading; 0: the rig's noise density times the root of the rate.
        accelerometer_stddev: f64 = 0.0, unit("m/s^2"), range(0.0..=100.0), live;
        /// Standard deviation of one reading; 0: the rig's noise density times the root of the rate.
        gyroscope_stddev: f64 = 0.0, unit("rad/s"), range(0.0..=100.0), live;
        /// Standard deviation of the orientation's roll and pitch (data sheet, in motion).
        tilt_stddev: f64 = 0.035, unit("rad"), range(0.0..=3.2), name("orientation_stddev.tilt"), live;
        /// Standard deviation of the orientation's heading.
        heading_stddev: f64 = 0.087, unit("rad"), range(0.0..=3.2), name("orientation_stddev.heading"), live;
        /// Tesla per unit of the magnetic field as the unit sends it (the Earth's field is about 1).
        magnetic_field_scale: f64 = 5e-5, unit("T"), range(0.0..=1.0), live;
        /// Standard deviation of the magnetic field, in the unit's own units.
        magnetic_field_stddev: f64 = 0.0015, range(0.0..=10.0), live;
        /// Readings of an accelerometer beyond this count as clipping; 0: only what the status bits say.
        accelerometer_range: f64 = 0.0, unit("m/s^2"), range(0.0..=10000.0), live;
        /// Readings of a gyroscope beyond this count as clipping; 0: only what the status bits say.
        gyroscope_range: f64 = 0.0, unit("rad/s"), range(0.0..=1000.0), live;
        /// Publish volant -> imu on /tf_static; false where robot_state_publisher does it.
        publish_static_tf: bool = true;
    }
    check(p) { p.config().and_then(|c| c.check().map_err(|e| e.to_string())) }
}

impl ImuParameters {
    /// As the core wants them.
    ///
    /// # Errors
    /// A number format that is none.
    pub fn config(&self) -> Result<DriverConfig, String> {
        let number_format = match self.number_format.as_str() {
            "float32" => NumberFormat::Float32,
            "fp12.20" => NumberFormat::Fp1220,
            "fp16.32" => NumberFormat::Fp1632,
            "double" => NumberFormat::Float64,
            other => {
                return Err(format!(
                    "outputs.number_format is `{other}`; use float32, fp12.20, fp16.32 or double"
                ));
            }
        };
        Ok(DriverConfig {
            baud: (self.baud != 0).then_some(self.baud),
            rate: self.rate,
            orientation: self.orientation,
            magnetic_field: self.magnetic_field,
            temperature: self.temperature,
            status: self.status,
            number_format,
            leave_settings: self.leave_settings,
            two_stop_bits: self.two_stop_bits,
            transmission_delay: (self.transmission_delay >= 0.0).then_some(self.transmission_delay),
            longest_pause: self.longest_pause,
            clock: ClockFitConfig { patience: PATIENCE, ..ClockFitConfig::default() },
            ..DriverConfig::default()
        })
    }
}

/// The node.
pub struct ImuNode {
    parameters: ImuParameters,
    frames: Frames,
    /// From the rig, (m/s²)² and (rad/s)².
    variances: (f64, f64),
    data: Publisher<Imu>,
    magnetic_field: Publisher<MagneticField>,
    temperature: Publisher<Temperature>,
    status: Option<DriverStatus>,
    before: Statistics,
    clipped: u64,
    clipped_before: u64,
    trouble: Option<String>,
}

impl NodeShell for ImuNode {
    const NAME: &'static str = "imu_driver";
    const ABOUT: &'static str = "an Xsens inertial unit's bytes in, inertial samples out";
    type Parameters = ImuParameters;
    type Input = Report;

    fn start(kit: &mut Kit<Report>, parameters: ImuParameters) -> Result<Self, NodeError> {
        let rig = kit.rig()?;
        let config = parameters.config().map_err(NodeError::shell)?;
        let driver = Driver::new(config).map_err(|e| NodeError::shell(e.to_string()))?;
        let data = kit.advertise("volant/imu/data", QosPreset::Sensor)?;
        let magnetic_field = kit.advertise("imu/mag", QosPreset::Sensor)?;
        let temperature = kit.advertise("imu/temperature", QosPreset::Sensor)?;
        let first_baud = if parameters.baud == 0 { 115_200 } else { parameters.baud };
        let opened = match Port::open(&parameters.port, first_baud, parameters.two_stop_bits) {
            Ok(port) => Some(port),
            Err(_) if parameters.wait_for_device => None,
            Err(error) => {
                return Err(NodeError::shell(format!(
                    "{error}; wait_for_device: true makes the node wait for it"
                )));
            }
        };
        if parameters.publish_static_tf {
            kit.send_static_transform(convert::transform_message(
                &rig.frames.volant,
                &rig.frames.imu,
                kit.now(),
                &rig.imu.volant_from_imu,
            ))?;
        }
        let sender = kit.device_sender(&parameters.port, 1024);
        let clock = kit.clock();
        let runner = Runner { port: parameters.port.clone(), driver, raw: false, opened };
        kit.spawn("imu-serial", move || {
            let alive = sender.clone();
            let mut watch = clock.watch();
            runner.run(|| clock.now(), || watch.set_by(), |report| sender.send(report), || alive.is_open());
        })?;
        let per_sample = |density: f64| density * density * parameters.rate;
        let variances =
            (per_sample(rig.imu.accelerometer_noise_density), per_sample(rig.imu.gyroscope_noise_density));
        Ok(Self {
            frames: rig.frames,
            variances,
            data,
            magnetic_field,
            temperature,
            status: None,
            before: Statistics::default(),
            clipped: 0,
            clipped_before: 0,
            trouble: None,
            parameters,
        })
    }

    fn handle(&mut self, kit: &mut Kit<Report>, input: Report) {
        match input {
            Report::Sample(sample) => self.publish(sample),
            Report::Event(event) => self.tell(kit, &event),
            Report::Status(status) => self.status = Some(*status),
            Report::Bytes(_) => {}
        }
    }

    fn tick(&mut self, kit: &mut Kit<Report>) {
        let port = self.parameters.port.clone();
        let Some(status) = &self.status else {
            kit.diagnose("unit", Health::Warn, "starting", &[("port", port)]);
            return;
        };
        let now = status.statistics;
        let before = std::mem::replace(&mut self.before, now);
        let lost = now.lost - before.lost;
        let checksums = now.parser.bad_checksums - before.parser.bad_checksums;
        let skipped = now.parser.skipped_bytes - before.parser.skipped_bytes;
        let clipped = self.clipped - std::mem::replace(&mut self.clipped_before, self.clipped);
        let self_test = now.status.map(Status::self_test_passed);
        let (health, message) = if !status.measuring {
            (Health::Error, self.trouble.clone().unwrap_or_else(|| status.state.to_owned()))
        } else if self_test == Some(false) {
            (Health::Error, "the unit's self-test failed: send it in for repair".to_owned())
        } else if now.samples == before.samples {
            (Health::Error, "no samples in the last second".to_owned())
        } else if before.connections > 0 && now.connections > before.connections {
            (
                Health::Warn,
                "the unit fell silent or started anew in the last second, and was set up again".to_owned(),
            )
        } else if lost > 0 {
            (Health::Warn, format!("{lost} samples lost in the last second"))
        } else if checksums > 0 {
            (Health::Warn, format!("{checksums} checksum errors in the last second: look at the cable"))
        } else if skipped > 0 {
            (
                Health::Warn,
                format!("{skipped} bytes in the last second belonged to no message: look at the cable"),
            )
        } else if clipped > 0 {
            (Health::Warn, format!("{clipped} samples clipped in the last second"))
        } else {
            (Health::Ok, "samples flow".to_owned())
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
        kit.diagnose("unit", health, &message, &values);
    }

    fn parameters_changed(
        &mut self,
        _kit: &mut Kit<Report>,
        parameters: &ImuParameters,
    ) -> Result<(), String> {
        self.parameters = parameters.clone();
        Ok(())
    }
}

fn beyond(range: f64, v: &nalgebra::Vector3<f64>) -> bool {
    range > 0.0 && v.amax() >= range
}

impl ImuNode {
    fn publish(&mut self, sample: Sample) {
        let p = &self.parameters;
        let by_status = sample.status.is_some_and(Status::any_clipping);
        let by_range = sample.imu.as_ref().is_some_and(|imu| {
            beyond(p.accelerometer_range, &imu.specific_force)
                || beyond(p.gyroscope_range, &imu.angular_velocity)
        });
        self.clipped += u64::from(by_status || by_range);
        if let Some(mut imu) = sample.imu {
            if let Some(orientation) = &mut imu.orientation {
                let (tilt, heading) = (p.tilt_stddev * p.tilt_stddev, p.heading_stddev * p.heading_stddev);
                let diagonal = nalgebra::Vector3::new(tilt, tilt, heading);
                orientation.covariance = Some(Matrix3::from_diagonal(&diagonal));
            }
            let variance = |stddev: f64, from_rig: f64| {
                let v = if stddev > 0.0 { stddev * stddev } else { from_rig };
                (v > 0.0).then_some(v)
            };
            self.data.publish(convert::imu_message(
                &self.frames.imu,
                &imu,
                variance(p.accelerometer_stddev, self.variances.0),
                variance(p.gyroscope_stddev, self.variances.1),
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

    fn tell(&mut self, kit: &mut Kit<Report>, event: &Event) {
        let level = match event.severity() {
            Severity::Info => Level::Info,
            Severity::Warning => Level::Warn,
            Severity::Error => Level::Error,
        };
        let line = format!("{}: {event}", self.parameters.port);
        match event {
            Event::Measuring(_) => self.trouble = None,
            _ if level >= Level::Error => self.trouble = Some(event.to_string()),
            _ => {}
        }
        // What may come many times a second is said once in a while; the diagnostics count it.
        match event {
            Event::Lost { .. } => kit.log_throttled(level, "lost", line),
            Event::DeviceComplains { .. } => kit.log_throttled(level, "complains", line),
            Event::ClockSet { .. } | Event::ClockStepped { .. } | Event::UnitRestarted => {
                kit.log_throttled(level, "clock", line)
            }
            _ => kit.log(level, line),
        }
    }
}
