//! Values of the diagnostics.

use crate::Status;

/// Returns counters and insights by name.
pub fn values(s: &Status) -> Vec<(&'static str, String)> {
    let c = &s.counts;
    let (inputs, rejected, resets) = (&c.inputs, &c.rejected, &c.resets);
    let rope = s.rope.map_or("none".to_owned(), |r| {
        format!("{:.4} +- {:.4}", r.length, (r.length_variance + r.stretch_variance).sqrt())
    });
    let side_force = s.rope.map_or("none".to_owned(), |r| format!("{:.3}", r.side_variance.sqrt()));
    let offset = format!("{:.2} +- {:.2}", s.time_offset.offset * 1e3, s.time_offset.sigma * 1e3);
    let three = |first: usize, factor: f64| {
        let c = &s.constants;
        let [x, y, z] = [0, 1, 2].map(|k| factor * c[first + k]);
        format!("{x:.2} {y:.2} {z:.2}")
    };
    vec![
        ("position sigma (m)", format!("{:.5}", s.position_sigma)),
        ("markers used", c.used_markers.to_string()),
        ("markers rejected", c.gated_markers.to_string()),
        ("shocks", resets.shocks.to_string()),
        ("reinitializations from contradicting markers", resets.recoveries.to_string()),
        ("reinitializations from unsound states", resets.divergences.to_string()),
        ("encoder readings excluded", c.excluded_readings.to_string()),
        ("encoder steps adopted", resets.encoder_steps.to_string()),
        ("IMU samples rejected", rejected.imu.to_string()),
        ("IMU samples late", inputs.late_imu.to_string()),
        ("IMU gaps", inputs.imu_gaps.to_string()),
        ("images rejected", rejected.images.to_string()),
        ("markers with invalid values", rejected.markers.to_string()),
        ("climber samples rejected", rejected.climber.to_string()),
        ("duplicates", inputs.duplicates.to_string()),
        ("history overflows", inputs.overflows.to_string()),
        ("jumps of time", resets.time_jumps.to_string()),
        ("steps of a clock", resets.clock_steps.to_string()),
        ("camera time offset (ms)", offset),
        ("camera time offset known", (!s.time_offset.searching).to_string()),
        ("accelerometer noise density", format!("{:.5}", s.imu_noise.force.sqrt())),
        ("gyroscope noise density", format!("{:.6}", s.imu_noise.rate.sqrt())),
        ("gyroscope scale factors (%)", three(0, 100.0)),
        ("accelerometer scale factors (%)", three(3, 100.0)),
        ("gyroscope misalignment (deg)", three(6, 1f64.to_degrees())),
        ("accelerometer misalignment (deg)", three(9, 1f64.to_degrees())),
        ("largest offset of a marker (mm)", format!("{:.2}", 1e3 * s.marker_offset())),
        ("pixel noise factor", format!("{:.2}", s.pixel_noise_factor)),
        ("rope (m)", rope),
        ("force across the rope (m/s^2)", side_force),
    ]
}
