//! Which joint moves which axis, and initial values of the fit: linear regression of the poses of
//! single images on the readings.

use super::{ClimberError, Series, Shot};
use crate::recording::heading;
use nalgebra::{DMatrix, DVector, Rotation2, Vector2};
use rig_model::wrap_angle;

/// Smallest motion of an axis that counts, m and rad.
const MOVED: [f64; 2] = [0.1, 0.1];
/// Smallest share of a motion that its joints explain.
const EXPLAINED: f64 = 0.98;
/// Joints that explain a motion equally well, up to this share, measure the same axis.
const SAME: f64 = 1e-3;

/// Joints of the axes, and initial values.
pub(super) struct Assigned {
    /// Index of the joint and scale, per axis.
    pub axes: [Option<(usize, f64)>; 3],
    /// Yaw of the platform in the world, rad.
    pub platform_yaw: f64,
    /// Turn of the climber in the first image, rad.
    pub turn: f64,
    /// Climber in the first image, from the platform, world axes, m.
    pub position: Vector2<f64>,
}

pub(super) fn assign(
    shots: &[Shot],
    series: &[Series],
    preferred: &[&str; 3],
) -> Result<Assigned, ClimberError> {
    // Yaw and position of the climber in the platform's frame, in which nothing else moves.
    let (mut yaw, mut place) = (vec![], vec![]);
    for shot in shots {
        let own = -heading(&shot.climber_from_volant.rotation);
        let last = yaw.last().copied().unwrap_or(own);
        yaw.push(last + wrap_angle(own - last));
        place.push(-(Rotation2::new(own) * shot.climber_from_volant.translation.vector.xy()));
    }
    let readings: Vec<Vec<f64>> = series
        .iter()
        .map(|s| shots.iter().map(|shot| s.at(shot.time).unwrap_or(0.0)).collect())
        .collect();
    let span = |values: &[f64]| {
        let (low, high) = values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        high - low
    };
    let moving: Vec<usize> = (0..series.len()).filter(|&j| span(&readings[j]) > 0.0).collect();
    let turned = span(&yaw) > MOVED[1];
    // With the camera off the climber's axis, a turn moves it on a circle.
    let both = |x: fn(f64) -> f64, y: fn(f64) -> f64| -> Vec<f64> {
        yaw.iter().map(|a| x(*a)).chain(yaw.iter().map(|a| y(*a))).collect()
    };
    let circle = match turned {
        true => vec![both(f64::cos, f64::sin), both(|a: f64| -a.sin(), f64::cos)],
        false => vec![],
    };
    let coordinates: Vec<f64> =
        place.iter().map(|p| p.x).chain(place.iter().map(|p| p.y)).collect();
    let prefer =
        |joint: usize, axes: &[usize]| axes.iter().any(|&a| preferred[a] == series[joint].name);
    let turn = if turned {
        let fits = moving.iter().map(|&j| {
            let fit = regress(shots.len(), &yaw, &readings[j..=j]);
            (vec![j], fit)
        });
        let (joints, fit) = best(fits.collect(), |j| prefer(j, &[2]))
            .ok_or_else(|| ClimberError::few_images(shots.len()))?;
        enough(&fit, "turns", &series[joints[0]].name)?;
        Some((joints[0], fit.coefficients[0]))
    } else {
        None
    };
    // Motion along the rails, less the circle.
    let still = regress_plane(&coordinates, &[], &circle);
    let rails = still.residual_axes;
    let count = rails.iter().filter(|&&s| s > MOVED[0]).count();
    if count == 0 && turn.is_none() {
        let (meters, degrees) = (rails[0], span(&yaw).to_degrees());
        return Err(ClimberError(format!(
            "no axis moved: the camera's position varies by {meters:.3} m and {degrees:.1} deg; \
             jog each axis by 0.3 m or 20 deg at least"
        )));
    }
    let candidates: Vec<usize> =
        moving.iter().copied().filter(|j| turn.is_none_or(|t| t.0 != *j)).collect();
    let sets: Vec<Vec<usize>> = match count {
        0 => vec![],
        1 => candidates.iter().map(|&j| vec![j]).collect(),
        _ => pairs(&candidates),
    };
    let fits = sets.into_iter().map(|set| {
        let chosen: Vec<&Vec<f64>> = set.iter().map(|&j| &readings[j]).collect();
        let fit = regress_plane(&coordinates, &chosen, &circle);
        (set, fit)
    });
    let found = best(fits.collect(), |j| prefer(j, &[0, 1]));
    let mut axes = [None, None, turn];
    let mut platform_yaw = -yaw[0];
    if count > 0 {
        let none = || {
            let joint = candidates.first().map_or("", |&j| series[j].name.as_str());
            ClimberError::no_joint("moves along two rails", joint, 0.0)
        };
        let (joints, fit) = found.ok_or_else(none)?;
        let motion = if count == 1 { "moves along a rail" } else { "moves along two rails" };
        enough(&fit, motion, &series[joints[0]].name)?;
        // Rails in the climber's frame at the start: the one nearest to its x axis is x.
        let mut rails: Vec<(usize, Vector2<f64>)> = joints
            .iter()
            .enumerate()
            .map(|(i, &j)| (j, Vector2::new(fit.coefficients[2 * i], fit.coefficients[2 * i + 1])))
            .collect();
        let own = |v: &Vector2<f64>| Rotation2::new(-yaw[0]) * v;
        let along_x = |v: &Vector2<f64>| own(v).normalize().x.abs();
        rails.sort_by(|a, b| along_x(&b.1).total_cmp(&along_x(&a.1)));
        let mut direction = Vector2::zeros();
        for (k, (joint, vector)) in rails.iter().enumerate() {
            let axis =
                if k == 1 || along_x(vector) < std::f64::consts::FRAC_1_SQRT_2 { 1 } else { 0 };
            let sign = own(vector)[axis].signum();
            axes[axis] = Some((*joint, sign * vector.norm()));
            let forward = vector.normalize() * sign;
            // A rail along y points to where x is after a quarter turn.
            direction += if axis == 0 { forward } else { Vector2::new(forward.y, -forward.x) };
        }
        platform_yaw = -direction.y.atan2(direction.x);
    }
    Ok(Assigned {
        axes,
        platform_yaw,
        turn: wrap_angle(yaw[0] + platform_yaw),
        position: Rotation2::new(platform_yaw) * place[0],
    })
}

fn pairs(joints: &[usize]) -> Vec<Vec<usize>> {
    let with = |i: usize| joints[i + 1..].iter().map(move |&b| vec![joints[i], b]);
    (0..joints.len()).flat_map(with).collect()
}

/// Result of a regression.
struct Fit {
    coefficients: Vec<f64>,
    /// Share of the variance that is explained.
    explained: f64,
    /// Extent of the residuals along their two principal axes, larger first.
    residual_axes: [f64; 2],
}

/// The fit that explains most; of those that do equally well, the one with the preferred joints.
fn best(fits: Vec<(Vec<usize>, Fit)>, prefer: impl Fn(usize) -> bool) -> Option<(Vec<usize>, Fit)> {
    let most = fits.iter().map(|f| f.1.explained).fold(f64::NEG_INFINITY, f64::max);
    fits.into_iter()
        .filter(|f| f.1.explained > most - SAME)
        .max_by_key(|f| f.0.iter().filter(|&&j| prefer(j)).count())
}

fn enough(fit: &Fit, motion: &str, joint: &str) -> Result<(), ClimberError> {
    if fit.explained > EXPLAINED {
        return Ok(());
    }
    Err(ClimberError::no_joint(motion, joint, 100.0 * fit.explained.max(0.0)))
}

/// Regresses the two coordinates, x of all images and then y, on readings, each with a coefficient
/// per coordinate, and on columns that both have in common.
fn regress_plane(coordinates: &[f64], readings: &[&Vec<f64>], common: &[Vec<f64>]) -> Fit {
    let n = coordinates.len() / 2;
    let zeros = vec![0.0; n];
    let mut columns: Vec<Vec<f64>> = vec![];
    for reading in readings {
        columns.push([reading.as_slice(), zeros.as_slice()].concat());
        columns.push([zeros.as_slice(), reading.as_slice()].concat());
    }
    columns.extend_from_slice(common);
    regress(n, coordinates, &columns)
}

/// Least squares of a target on columns of its form: one or two series of `n` values, one after the
/// other, each with an offset of its own.
fn regress(n: usize, target: &[f64], columns: &[Vec<f64>]) -> Fit {
    let centered = |values: &[f64]| {
        let parts = values.chunks(n).flat_map(|part| {
            let mean = part.iter().sum::<f64>() / n as f64;
            part.iter().map(move |v| v - mean)
        });
        DVector::from_iterator(values.len(), parts)
    };
    let y = centered(target);
    let mut a = DMatrix::zeros(y.len(), columns.len());
    let mut scales = vec![];
    for (i, column) in columns.iter().enumerate() {
        let column = centered(column);
        scales.push(column.norm().max(f64::MIN_POSITIVE));
        a.set_column(i, &(column / scales[i]));
    }
    let solved =
        if columns.is_empty() { None } else { a.clone().svd(true, true).solve(&y, 1e-9).ok() };
    let residual = match &solved {
        Some(x) => &y - &a * x,
        None => y.clone(),
    };
    let coefficients =
        solved.iter().flat_map(|x| x.iter().zip(&scales).map(|(c, s)| c / s)).collect();
    let (u, v) = residual.as_slice().split_at(n);
    let moment = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(a, b)| a * b).sum::<f64>() / n as f64;
    let spread = nalgebra::Matrix2::new(moment(u, u), moment(u, v), moment(u, v), moment(v, v));
    // Twice √3 standard deviations: the extent of an even distribution.
    let mut axes = spread.symmetric_eigenvalues().map(|s| (12.0 * s.max(0.0)).sqrt());
    if axes[0] < axes[1] {
        axes.swap_rows(0, 1);
    }
    Fit {
        coefficients,
        explained: 1.0 - residual.norm_squared() / y.norm_squared().max(f64::MIN_POSITIVE),
        residual_axes: [axes[0], axes[1]],
    }
}
