//! The layout of the markers: units, exchanged colors, a mirrored layout, a marker far off; and a
//! camera that looks elsewhere.

use super::{Corrected, Track, findings::Finding};
use crate::{
    CalibrationError,
    recording::{Recording, all_detected},
};
use nalgebra::{Matrix2, Quaternion, UnitQuaternion, Vector2, Vector3};
use rig_model::{
    CameraModel, MarkerColor, MarkerLayout, MarkerObservations, MarkerState, PerColor, median,
    planar_pose,
};

/// Largest distance of a marker from the layout's center, and of a sensor from its frame, m: a
/// platform that a climber carries.
const REACH: f64 = 3.0;
/// Share of images with four markers above which the layout is good enough to track with.
const TRACKED: f64 = 0.3;
/// First images with which other layouts are tried; more where the first do not show all markers.
const TRIALS: [usize; 2] = [30, 120];
/// Images in which the reprojection error is compared.
const COMPARED: usize = 40;
/// Standard deviation of a centroid in that comparison, px: lens and layout within a survey.
const PIXEL: f64 = 0.5;
/// Median squared residual (two degrees of freedom) of a layout that fits, and factor by which the
/// file's must exceed it.
const FITS: f64 = 30.0;
const WORSE: f64 = 10.0;
/// Angle between the platform's mean normal and the climber's vertical that is possible, rad.
const LEAN: f64 = 0.35;

/// Key of a layout of which one coordinate has the wrong sign.
pub(crate) const MIRRORED: &str = "markers.mirrored";

/// A layout that the files may have meant.
struct Candidate {
    layout: MarkerLayout,
    /// What is wrong in the file; empty for the file's layout.
    text: String,
    key: String,
    moved: Option<usize>,
}

/// Examines units, colors and mirroring; tracks the images again where the file's layout finds
/// nothing.
///
/// # Errors
/// No images show all markers, whatever the layout.
pub(crate) fn examine(
    state: &mut Corrected,
    mut track: Option<&mut Track<'_>>,
) -> Result<(), CalibrationError> {
    units(state, track.as_deref_mut());
    if state.findings.iter().any(|f| f.blocks) {
        return Ok(());
    }
    let candidates = candidates(&state.rig.markers);
    if let Some(track) = track
        && share(&state.samples.markers) < TRACKED
    {
        let camera = state.samples.camera.clone();
        for images in TRIALS {
            let trials: Vec<(f64, f64, &Candidate)> = candidates
                .iter()
                .map(|c| {
                    let markers = track(&c.layout, &camera, Some(images));
                    (share(&markers), cost(&c.layout, &camera, &centroids(&markers)), c)
                })
                .collect();
            let most = trials.iter().map(|t| t.0).fold(0.0, f64::max);
            // A turned layout is nearly the same: of those that find the markers, the one that
            // fits.
            let found = trials.iter().filter(|t| t.0 > TRACKED && t.0 > 0.5 * most);
            if let Some((_, _, candidate)) = found.min_by(|a, b| a.1.total_cmp(&b.1)) {
                state.samples.markers = track(&candidate.layout, &camera, None);
                break;
            }
        }
    }
    let shots = centroids(&state.samples.markers);
    if shots.is_empty() {
        state.findings.push(missing(state).ok_or(CalibrationError::FewImages(0))?);
        return Ok(());
    }
    let every = (shots.len() / COMPARED).max(1);
    let shots: Vec<_> = shots.into_iter().step_by(every).collect();
    let costs: Vec<(f64, &Candidate)> =
        candidates.iter().map(|c| (cost(&c.layout, &state.samples.camera, &shots), c)).collect();
    let file = costs[0].0;
    let best = |moved: bool| {
        let others = costs[1..].iter().filter(|(_, c)| c.moved.is_some() == moved);
        others.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    if let Some((least, c)) = best(false)
        && *least < FITS
        && file > WORSE * least.max(1.0)
    {
        state.rig.markers = c.layout.clone();
        if c.key == MIRRORED {
            let other = candidates.iter().find(|o| o.key == MIRRORED && o.text != c.text);
            state.other_mirror = other.map(|o| (o.layout.clone(), o.text.clone()));
        }
        state.findings.push(Finding::wrong(
            &c.key,
            c.text.clone(),
            "compare the colors and coordinates in the rig file with the platform, seen from above",
        ));
    } else if let Some((least, c)) = best(true)
        && file > WORSE * least.max(FITS)
    {
        state.rig.markers = c.layout.clone();
        state.moved = c.moved;
    }
    Ok(())
}

/// One marker that is not where the file has it, while the others are.
fn missing(state: &Corrected) -> Option<Finding> {
    let images = state.samples.markers.len() as f64;
    let shown = MarkerColor::ALL.map(|color| {
        let found = |m: &&MarkerObservations| m.markers[color].state == MarkerState::Detected;
        state.samples.markers.iter().filter(found).count() as f64 / images
    });
    let absent: Vec<usize> = (0..4).filter(|i| shown[*i] < 0.05).collect();
    let [one] = absent[..] else { return None };
    if shown.iter().filter(|s| **s > TRACKED).count() != 3 {
        return None;
    }
    let color = MarkerColor::ALL[one].name();
    Some(Finding {
        blocks: true,
        ..Finding::wrong(
            &format!("markers.{color}"),
            format!(
                "the {color} marker is not where the file has it, while the other three are found"
            ),
            format!(
                "measure markers.{color} again; if it is right, calibrate its color with `volant \
                 calibrate colors`"
            ),
        )
    })
}

/// Share of the images that have four markers.
fn share(markers: &[MarkerObservations]) -> f64 {
    let full = markers.iter().filter(|m| all_detected(m)).count();
    full as f64 / markers.len().max(1) as f64
}

/// Centroids in the images with four markers.
fn centroids(markers: &[MarkerObservations]) -> Vec<PerColor<Vector2<f64>>> {
    let full = markers.iter().filter(|m| all_detected(m));
    full.map(|m| PerColor(m.markers.0.map(|o| o.centroid))).collect()
}

/// A unit and its factor to meters.
type Unit = (&'static str, f64);

/// Reach of a layout that is not in meters, and the units that it may have.
///
/// The side is in meters, because the rig file accepts no other, and markers do not overlap.
fn possible_units(layout: &MarkerLayout) -> Option<(f64, Vec<Unit>)> {
    let centers = &layout.centers.0;
    let mean = centers.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 4.0;
    let reach = centers.iter().map(|c| (c.coords - mean).norm()).fold(0.0, f64::max);
    let pairs = (0..4).flat_map(|i| (0..i).map(move |k| (centers[i] - centers[k]).norm()));
    let spacing = pairs.fold(f64::INFINITY, f64::min);
    let mut units = vec![("millimeters", 1e-3), ("centimeters", 1e-2)];
    units.retain(|(_, factor)| spacing * factor >= layout.side && reach * factor <= REACH);
    if units.is_empty() {
        units.push(("centimeters", 1e-2));
    }
    (reach > REACH).then_some((reach, units))
}

/// Brings marker positions in millimeters or centimeters to meters. The images decide where both
/// are possible: centroids fit at any scale, but the markers are found with the right one only.
fn units(state: &mut Corrected, track: Option<&mut Track<'_>>) {
    let file = state.rig.markers.clone();
    let Some((reach, mut units)) = possible_units(&file) else { return };
    let in_meters = |(_, factor): Unit| MarkerLayout {
        side: file.side,
        centers: PerColor(file.centers.0.map(|c| c * factor)),
    };
    if let (&[a, b], Some(track)) = (&units[..], track) {
        let camera = &state.samples.camera;
        let [of_a, of_b] =
            [a, b].map(|unit| share(&track(&in_meters(unit), camera, Some(TRIALS[1]))));
        if of_a.max(of_b) > TRACKED {
            units = vec![if of_a > of_b { a } else { b }];
        }
    }
    state.rig.markers = in_meters(units[0]);
    let names: Vec<&str> = units.iter().map(|unit| unit.0).collect();
    let text = format!(
        "markers.red, markers.green, markers.blue and markers.yellow are in {} instead of meters: \
         {reach:.1} m from their center is impossible",
        names.join(" or ")
    );
    let finding = Finding::wrong("markers.red", text, "write the marker positions in meters");
    state.findings.push(Finding { blocks: names.len() > 1, ..finding });
}

/// Unit of a mounting position of this length that is not in meters, and a factor to meters: a
/// mounting is longer than a centimeter and within `REACH`.
pub(super) fn unit_of(length: f64) -> Unit {
    match (length * 1e-3 >= 1e-2, length * 1e-2 < REACH) {
        (false, _) => ("centimeters", 1e-2),
        (true, true) => ("millimeters or centimeters", 1e-3),
        (true, false) => ("millimeters", 1e-3),
    }
}

/// Brings mounting positions in millimeters or centimeters to meters.
pub(crate) fn examine_places(state: &mut Corrected) {
    let rig = &mut state.rig;
    for (key, place) in [
        ("imu.position", &mut rig.imu.volant_from_imu.translation.vector),
        ("camera.position", &mut rig.climber_from_camera.translation.vector),
    ] {
        let norm = place.norm();
        if norm < REACH {
            continue;
        }
        let (unit, factor) = unit_of(norm);
        *place *= factor;
        state.findings.push(Finding::wrong(
            key,
            format!("{key} is in {unit} instead of meters: {norm:.1} m is impossible"),
            "write it in meters",
        ));
    }
}

/// The file's layout first; then exchanged colors, mirrored layouts, and layouts in which one
/// marker completes the parallelogram of the other three.
fn candidates(file: &MarkerLayout) -> Vec<Candidate> {
    let of = |layout, key: &str, text: String, moved| Candidate {
        layout,
        key: key.to_owned(),
        text,
        moved,
    };
    let mut list = vec![of(file.clone(), "", String::new(), None)];
    for order in permutations().into_iter().skip(1) {
        let mut layout = file.clone();
        for (i, from) in order.iter().enumerate() {
            layout.centers.0[i] = file.centers.0[*from];
        }
        let (key, text) = exchanged(&order);
        list.push(of(layout, &key, text, None));
    }
    for (axis, name) in [(1, "y"), (0, "x")] {
        let mut layout = file.clone();
        layout.centers.0.iter_mut().for_each(|c| c[axis] = -c[axis]);
        let text = format!(
            "the marker layout is mirrored: the signs of the {name} coordinates are exchanged"
        );
        list.push(of(layout, MIRRORED, text, None));
    }
    for i in 0..4 {
        // The two neighbors of a marker are those that its opposite is not: try all three.
        let others: Vec<usize> = (0..4).filter(|k| *k != i).collect();
        for opposite in &others {
            let c = |k: usize| file.centers.0[k].coords;
            let sum: Vector3<f64> = others.iter().filter(|k| *k != opposite).map(|k| c(*k)).sum();
            let mut layout = file.clone();
            layout.centers.0[i].coords = sum - c(*opposite);
            list.push(of(layout, "", String::new(), Some(i)));
        }
    }
    list
}

/// All orders of four markers, the unchanged one first.
fn permutations() -> Vec<[usize; 4]> {
    let orders = (0..256).map(|i: usize| [i >> 6 & 3, i >> 4 & 3, i >> 2 & 3, i & 3]);
    orders.filter(|order| (0..4).all(|k| order.contains(&k))).collect()
}

fn exchanged(order: &[usize; 4]) -> (String, String) {
    let color = |i: usize| MarkerColor::ALL[i].name();
    let moved: Vec<usize> = (0..4).filter(|i| order[*i] != *i).collect();
    if let [a, b] = moved[..] {
        let (a, b) = (color(a), color(b));
        return (format!("markers.{a}"), format!("the markers {a} and {b} are exchanged"));
    }
    let places: Vec<String> = moved
        .iter()
        .map(|i| format!("{} is where the file has {}", color(*i), color(order[*i])))
        .collect();
    let mirrored = [[1, 0, 3, 2], [3, 2, 1, 0]].contains(order);
    let what = if mirrored {
        "the marker layout is mirrored (or its colors are exchanged in pairs)"
    } else if moved.len() == 4 {
        "the marker colors are rotated by a place"
    } else {
        "three marker colors are exchanged"
    };
    let key = if mirrored { "markers.exchanged" } else { "markers.colors" };
    (key.to_owned(), format!("{what}: {}", places.join(", ")))
}

/// Median squared residual of the best pose of each image; infinite where most have none.
fn cost(layout: &MarkerLayout, camera: &CameraModel, shots: &[PerColor<Vector2<f64>>]) -> f64 {
    let covariance = Matrix2::identity() * (PIXEL * PIXEL);
    let costs = shots
        .iter()
        .map(|shot| {
            let measured = PerColor(shot.0.map(|pixel| Some((pixel, covariance))));
            let poses = planar_pose::candidates(layout, camera, &measured, None);
            poses.first().map_or(f64::INFINITY, |p| p.pixel_cost)
        })
        .collect();
    median(costs).unwrap_or(f64::INFINITY)
}

/// A quaternion whose numbers were read as x, y, z, w, but written with w first.
pub(super) fn w_first(read: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let q = read.coords;
    UnitQuaternion::from_quaternion(Quaternion::new(q.x, q.y, q.z, q.w))
}

/// Compares the platform's mean normal with the vertical of the rig file's camera.
pub(crate) fn examine_view(state: &mut Corrected, recording: &Recording) {
    let covariance = Matrix2::identity() * (PIXEL * PIXEL);
    let mut normal = Vector3::zeros();
    for shot in recording.shots.iter().step_by((recording.shots.len() / COMPARED).max(1)) {
        let measured = PerColor(shot.pixels.map(|pixel| Some((pixel, covariance))));
        let poses = planar_pose::candidates(&state.rig.markers, &recording.camera, &measured, None);
        // Of the two poses of a plane the mean is the one that faces the camera.
        for pose in poses.iter().take(2) {
            normal += pose.camera_from_volant.rotation * Vector3::z();
        }
    }
    let camera = &mut state.rig.climber_from_camera.rotation;
    let up = *camera * normal;
    if normal.norm() < 1e-9 || up.angle(&Vector3::z()) < LEAN {
        return;
    }
    let swapped = w_first(camera);
    let degrees = up.angle(&Vector3::z()).to_degrees();
    let text = if (swapped * normal).angle(&Vector3::z()) < LEAN {
        *camera = swapped;
        "camera.orientation is written as w, x, y, z; the file needs x, y, z, w".to_owned()
    } else {
        if let Some(turn) = UnitQuaternion::rotation_between(&up, &Vector3::z()) {
            *camera = turn * *camera;
        }
        format!("camera.orientation is off by about {degrees:.0}°: the platform would hang askew")
    };
    let remedy = "write climber_from_camera_optical as x, y, z, w; for a camera that looks \
                  straight down it is [0.7071, 0.7071, 0, 0]";
    state.findings.push(Finding::wrong("camera.orientation", text, remedy));
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn the_unit_of_a_layout_follows_from_the_size_of_its_markers() {
        let layout = |reach: f64, side: f64| MarkerLayout {
            side,
            centers: PerColor(
                [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
                    .map(|[x, y]| Point3::new(reach * x, reach * y, 0.0)),
            ),
        };
        let of = |reach, side| {
            let units = possible_units(&layout(reach, side)).map_or(vec![], |found| found.1);
            units.into_iter().map(|unit| unit.0).collect::<Vec<_>>().join(" or ")
        };
        assert_eq!(of(0.15, 0.076), "");
        assert_eq!(of(15.0, 0.076), "centimeters");
        assert_eq!(of(250.0, 0.076), "millimeters");
        // Small markers are possible.
        assert_eq!(of(15.0, 0.025), "millimeters or centimeters");
    }

    #[test]
    fn exchanged_colors_are_named() {
        assert_eq!(permutations().len(), 24);
        assert_eq!(permutations()[0], [0, 1, 2, 3]);
        let (key, text) = exchanged(&[1, 0, 2, 3]);
        assert_eq!(
            (key.as_str(), text.as_str()),
            ("markers.red", "the markers red and green are exchanged")
        );
        assert!(
            exchanged(&[1, 2, 3, 0])
                .1
                .contains("rotated by a place: red is where the file has green")
        );
        assert!(exchanged(&[1, 0, 3, 2]).1.contains("mirrored"));
    }
}
