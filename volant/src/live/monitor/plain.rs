//! Formats a snapshot as text, for pipes, logs and tests; the screen uses the same cells.

use super::snapshot::{
    FilterState, Flow, InputLine, MarkerState, PoseState, RigState, Snapshot, StatusLine,
};
use std::fmt::Write;

/// Names of the levels of diagnostics.
pub const LEVELS: [&str; 4] = ["ok", "WARN", "ERROR", "STALE"];

/// Name of a diagnostic's level.
pub fn level(status: &StatusLine) -> &'static str {
    LEVELS.get(usize::from(status.level)).copied().unwrap_or("?")
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
        for line in rig_lines(rig, snapshot.now) {
            let _ = writeln!(out, "  {line}");
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
                status.node,
                status.name,
                status.message
            );
        }
    }
    out
}

/// Formats status, poses and markers, one line each.
pub fn rig_lines(rig: &RigState, now: u64) -> Vec<String> {
    let mut lines = vec![match &rig.status {
        Some(status) => format!("status  {}{}", status_line(status), old(status.at, now)),
        None => "status  nothing yet".to_owned(),
    }];
    for (what, pose) in [("fused ", &rig.odometry), ("camera", &rig.visual)] {
        match pose {
            Some(pose) => {
                let [position, angles] = pose_lines(pose);
                lines.push(format!("{what}  {position}{}", old(pose.at, now)));
                lines.push(format!("        {angles}"));
                if let Some([linear, angular]) = pose.speed {
                    lines.push(format!("        {linear:.3} m/s, {angular:.1} °/s"));
                }
            }
            None => lines.push(format!("{what}  nothing yet")),
        }
    }
    if rig.markers.is_empty() {
        lines.push("markers nothing yet".to_owned());
    }
    for marker in &rig.markers {
        lines.push(format!(
            "{:7} {}{}",
            marker.color.name(),
            marker_line(marker),
            old(rig.markers_at, now)
        ));
    }
    lines
}

/// Formats state, validity, standard deviations and reason.
pub fn status_line(status: &FilterState) -> String {
    format!(
        "{}, {}  ±{:.2} mm  ±{:.2} °{}{}",
        status.state,
        if status.valid { "valid" } else { "NOT VALID" },
        1e3 * status.position_sigma,
        status.rotation_sigma,
        if status.reason.is_empty() { "" } else { ": " },
        status.reason
    )
}

/// Formats position and rotation with their standard deviations.
pub fn pose_lines(pose: &PoseState) -> [String; 2] {
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
pub fn marker_line(marker: &MarkerState) -> String {
    let place = if marker.position[0].is_finite() {
        format!(
            "({:7.2}, {:7.2}) px ±{:.3}, {:.3}",
            marker.position[0], marker.position[1], marker.sigma[0], marker.sigma[1]
        )
    } else {
        String::new()
    };
    let hidden = match marker.hidden_for {
        Some(0) => String::new(),
        Some(n) => format!("hidden for {n} images"),
        None => "never seen".to_owned(),
    };
    format!(
        "{:9} {place}{}{hidden}",
        marker.state,
        if hidden.is_empty() || place.is_empty() { "" } else { ", " }
    )
    .trim_end()
    .to_owned()
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
pub(super) fn old(at: u64, now: u64) -> String {
    match now.saturating_sub(at) / 1_000_000_000 {
        0 | 1 => String::new(),
        seconds => format!("  ({seconds} s ago)"),
    }
}

#[cfg(test)]
mod tests {
    use super::{super::TopicLine, *};
    use nalgebra::Vector3;
    use rig_model::MarkerColor;

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
        let marker = |state, x, hidden_for| MarkerState {
            color: MarkerColor::Red,
            state,
            position: [x, 240.0],
            sigma: [0.02, 0.03],
            hidden_for,
        };
        let rig = RigState {
            odometry: Some(pose),
            visual: None,
            markers: vec![
                marker("DETECTED", 320.0, Some(0)),
                marker("LOST", f64::NAN, None),
                marker("PREDICTED", 9.0, Some(2)),
            ],
            markers_at: 0,
            status: Some(FilterState {
                at: 7_000_000_000,
                state: "LOST",
                valid: false,
                position_sigma: 0.25,
                rotation_sigma: 1.5,
                reason: "no image for 3.0 s".to_owned(),
            }),
        };
        let flow = Flow { rate: None, delay: None, count: 2, lost: 0 };
        let topic = TopicLine {
            name: "/tf_static".to_owned(),
            type_name: String::new(),
            publishers: 1,
            flow: Some(flow),
        };
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
