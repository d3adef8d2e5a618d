//! Formats a snapshot as text, for pipes, logs and tests; the screen uses the same cells.

use super::snapshot::{Flow, InputLine, PoseState, RigState, Snapshot};
use rig_model::MarkerColor;
use std::fmt::Write;
use volant_msgs::{
    diagnostic_msgs::msg::DiagnosticStatus,
    msg::{MarkerObservation, PoseStatus},
};

/// The name of a number; `?` without one.
fn named(names: &[&'static str], number: u8) -> &'static str {
    names.get(usize::from(number)).copied().unwrap_or("?")
}

/// Name of a diagnostic's level.
pub fn level(status: &DiagnosticStatus) -> &'static str {
    named(&["ok", "WARN", "ERROR", "STALE"], status.level)
}

/// How the screen shows a line about a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// A current value.
    Normal,
    /// The pose may be used.
    Good,
    /// The pose must not be used, or the value is old.
    Bad,
    /// No message so far.
    Missing,
    /// A marker.
    Marker(MarkerColor),
}

/// What to check where no topic is found.
pub fn nothing(snapshot: &Snapshot) -> String {
    format!(
        "nothing is published in {}: check that the nodes run, and that ROS_DOMAIN_ID, \
         ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_LOCALHOST_ONLY are the same for them",
        snapshot.place
    )
}

/// Formats a snapshot.
pub fn text(snapshot: &Snapshot) -> String {
    if snapshot.topics.is_empty() {
        return nothing(snapshot) + "\n";
    }
    let mut out = String::new();
    for (name, rig) in &snapshot.rigs {
        let _ = writeln!(out, "rig {}", if name.is_empty() { "/" } else { name });
        for (_, head, line) in rig_lines(rig, snapshot.now) {
            let _ = writeln!(out, "  {head:8}{line}");
        }
    }
    let _ = writeln!(out, "topics");
    let width = snapshot.topics.iter().map(|t| t.name.len()).max().unwrap_or(0);
    for topic in &snapshot.topics {
        let flow = topic
            .flow
            .as_ref()
            .map_or_else(|| "not subscribed".to_owned(), |f| flow_cells(f).join("  "));
        let publishers = match topic.publishers {
            0 => "  NO PUBLISHER".to_owned(),
            1 => String::new(),
            n => format!("  {n} publishers"),
        };
        let _ = writeln!(out, "  {:width$}  {flow}{publishers}", topic.name);
    }
    if !snapshot.inputs.is_empty() {
        let _ = writeln!(out, "inputs, as the nodes count them");
        for input in &snapshot.inputs {
            let _ = writeln!(out, "  {}", input_line(input));
        }
    }
    if !snapshot.statuses.is_empty() {
        let _ = writeln!(out, "diagnostics");
        for status in &snapshot.statuses {
            let _ = writeln!(
                out,
                "  {:5} {}: {}: {}",
                level(status),
                status.hardware_id,
                status.name,
                status.message
            );
        }
    }
    out
}

/// Formats status, poses and markers, one line each, with its head.
pub fn rig_lines(rig: &RigState, now: u64) -> Vec<(Tone, &'static str, String)> {
    let nothing = || "nothing yet".to_owned();
    let mut lines = vec![];
    match &rig.status {
        Some((at, status)) => {
            let age = old(*at, now);
            let tone = if status.valid && age.is_empty() { Tone::Good } else { Tone::Bad };
            lines.push((tone, "status", status_line(status) + &age));
        }
        None => lines.push((Tone::Bad, "status", nothing())),
    }
    for (what, pose) in [("fused", &rig.odometry), ("camera", &rig.visual)] {
        let Some(pose) = pose else {
            lines.push((Tone::Missing, what, nothing()));
            continue;
        };
        let age = old(pose.at, now);
        let tone = if age.is_empty() { Tone::Normal } else { Tone::Bad };
        let [position, angles] = pose_lines(pose);
        lines.push((tone, what, position + &age));
        lines.push((tone, "", angles));
        if let Some([linear, angular]) = pose.speed {
            lines.push((tone, "", format!("{linear:.3} m/s, {angular:.1} °/s")));
        }
    }
    if rig.markers.is_empty() {
        lines.push((Tone::Missing, "markers", nothing()));
    }
    for marker in &rig.markers {
        if let Some(color) = color(marker) {
            let line = marker_line(marker) + &old(rig.markers_at, now);
            lines.push((Tone::Marker(color), color.name(), line));
        }
    }
    lines
}

/// Color of a marker; `None` for an undefined one.
pub(super) fn color(marker: &MarkerObservation) -> Option<MarkerColor> {
    MarkerColor::ALL.get(usize::from(marker.color)).copied()
}

/// Formats state, validity, standard deviations and reason.
fn status_line(status: &PoseStatus) -> String {
    let states = ["INITIALIZING", "TRACKING", "COASTING", "VISION_ONLY", "LOST"];
    format!(
        "{}, {}  ±{:.2} mm  ±{:.2} °{}{}",
        named(&states, status.state),
        if status.valid { "valid" } else { "NOT VALID" },
        1e3 * status.position_sigma,
        status.rotation_sigma.to_degrees(),
        if status.reason.is_empty() { "" } else { ": " },
        status.reason
    )
}

/// Formats position and rotation with their standard deviations.
fn pose_lines(pose: &PoseState) -> [String; 2] {
    let axes = |names: [&str; 3],
                values: [f64; 3],
                sigmas: [f64; 3],
                unit: &str,
                digits: usize,
                small: (f64, &str)| {
        let cells: Vec<String> = names
            .iter()
            .zip(values.iter().zip(sigmas))
            .map(|(name, (value, sigma))| {
                format!("{name} {value:8.digits$} ±{:.2} {}", sigma * small.0, small.1)
            })
            .collect();
        format!("{} ({unit})", cells.join("  "))
    };
    [
        axes(["x", "y", "z"], pose.position.into(), pose.position_sigma, "m", 4, (1e3, "mm")),
        axes(["roll", "pitch", "yaw"], pose.angles, pose.angle_sigma, "°", 2, (1.0, "°")),
    ]
}

/// Formats state, position and standard deviations of a marker.
fn marker_line(marker: &MarkerObservation) -> String {
    let sigma = |i: usize| marker.covariance[i].max(0.0).sqrt();
    let place = if marker.x.is_finite() {
        format!("({:7.2}, {:7.2}) px ±{:.3}, {:.3}", marker.x, marker.y, sigma(0), sigma(3))
    } else {
        String::new()
    };
    let hidden = match marker.occluded_frames {
        0 => String::new(),
        u16::MAX => "never seen".to_owned(),
        n => format!("hidden for {n} images"),
    };
    let state = named(&["DETECTED", "PREDICTED", "LOST"], marker.state);
    let comma = if hidden.is_empty() || place.is_empty() { "" } else { ", " };
    format!("{state:9} {place}{comma}{hidden}").trim_end().to_owned()
}

/// Formats rate, delay, messages and losses.
pub fn flow_cells(flow: &Flow) -> [String; 4] {
    [
        match flow.rate {
            None => "  latched ".to_owned(),
            Some(rate) if rate > 0.0 => format!("{rate:7.1} Hz"),
            Some(_) => "  silent  ".to_owned(),
        },
        flow.delay.map_or_else(
            || format!("{:24}", ""),
            |(mean, max)| format!("delay {:6.1} max {:6.1} ms", mean * 1e3, max * 1e3),
        ),
        format!("{:7} messages", flow.count),
        format!("{} lost", flow.lost),
    ]
}

/// Formats a node's count of an input.
pub fn input_line(input: &InputLine) -> String {
    format!(
        "{} ← {}  {:.1} Hz, {} dropped, {} rejected, {} lost in transport",
        input.node, input.input, input.rate, input.dropped, input.rejected, input.lost
    )
}

/// Formats the age of a value that is older than two seconds.
fn old(at: u64, now: u64) -> String {
    match now.saturating_sub(at) / 1_000_000_000 {
        0 | 1 => String::new(),
        seconds => format!("  ({seconds} s ago)"),
    }
}

#[cfg(test)]
mod tests {
    use super::{super::TopicLine, *};
    use nalgebra::Vector3;

    #[test]
    fn what_matters_is_in_the_text() {
        let pose = PoseState {
            at: 0,
            position: Vector3::new(0.1, -0.2, -1.5),
            angles: [1.0, 2.0, 90.0],
            position_sigma: [0.0004, 0.0005, 0.0006],
            angle_sigma: [0.05, 0.06, 0.07],
            speed: Some([0.25, 12.0]),
        };
        let marker = |state, x, occluded_frames| MarkerObservation {
            state,
            occluded_frames,
            x,
            y: 240.0,
            covariance: [0.0004, 0.0, 0.0, 0.0009],
            ..MarkerObservation::default()
        };
        let rig = RigState {
            odometry: Some(pose),
            visual: None,
            markers: vec![
                marker(MarkerObservation::DETECTED, 320.0, 0),
                marker(MarkerObservation::LOST, f64::NAN, u16::MAX),
                marker(MarkerObservation::PREDICTED, 9.0, 2),
            ],
            markers_at: 0,
            status: Some((
                7_000_000_000,
                PoseStatus {
                    state: PoseStatus::LOST,
                    position_sigma: 0.25,
                    rotation_sigma: 1.5_f64.to_radians(),
                    reason: "no image for 3.0 s".to_owned(),
                    ..PoseStatus::default()
                },
            )),
        };
        let flow = Flow { rate: None, delay: None, count: 2, lost: 0 };
        let topic = TopicLine { name: "/tf_static".to_owned(), publishers: 1, flow: Some(flow) };
        let snapshot = Snapshot {
            rigs: vec![(String::new(), rig)],
            topics: vec![topic],
            now: 7_000_000_000,
            ..Snapshot::default()
        };
        let empty = Snapshot { place: "DDS domain 7".to_owned(), ..Snapshot::default() };
        let nothing = super::text(&empty);
        assert!(nothing.contains("DDS domain 7") && nothing.contains("ROS_DOMAIN_ID"), "{nothing}");
        let text = text(&snapshot);
        for needle in [
            "x   0.1000 ±0.40 mm",
            "yaw    90.00 ±0.07 °",
            "0.250 m/s, 12.0 °/s",
            "(7 s ago)",
            "camera  nothing yet",
            "status  LOST, NOT VALID  ±250.00 mm  ±1.50 °: no image for 3.0 s\n",
            "/tf_static    latched ",
            "DETECTED  ( 320.00,  240.00) px ±0.020, 0.030",
            "LOST      never seen",
            "±0.020, 0.030, hidden for 2 images",
        ] {
            assert!(text.contains(needle), "{needle} in\n{text}");
        }
    }
}
