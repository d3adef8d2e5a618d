//! Errors of six axes as bars.

use super::curves::Column;
use crate::accuracy::{AXES, Errors};
use volant::report::{Anchor, Drawing, Ink, colors};

/// Height of a panel, px.
const HIGH: f64 = 220.0;

/// The six errors on logarithmic scales: rotations above, positions below.
pub(super) fn draw_errors(errors: &[(&Column, Errors)]) -> String {
    let title = "Table II: RMSE of each axis";
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, title);
    for (i, (column, _)) in errors.iter().enumerate() {
        let (x, y) = (28.0 + 360.0 * (i % 3) as f64, 50.0 + 26.0 * (i / 3) as f64);
        d.bar(x, y, 20.0, 14.0, column.color);
        d.text(x + 28.0, y + 13.0, 15.0, colors::INK, Anchor::Start, column.name);
    }
    let head = 50.0 + 26.0 * errors.len().div_ceil(3) as f64;
    let mut bottom = head;
    for (half, (axes, unit)) in [([3, 4, 5], "deg"), ([0, 1, 2], "mm")].into_iter().enumerate() {
        let top = head + 50.0 + (HIGH + 86.0) * half as f64;
        draw_panel(&mut d, top, errors, axes, unit);
        bottom = top + HIGH + 40.0;
    }
    d.finish(bottom, title)
}

fn draw_panel(
    d: &mut Drawing,
    top: f64,
    errors: &[(&Column, Errors)],
    axes: [usize; 3],
    unit: &str,
) {
    let [low, up] = decades(errors, axes);
    let (base, x0, wide) = (top + HIGH, 84.0, 1000.0);
    let y =
        |v: f64| base - HIGH * ((v.max(low).log10() - low.log10()) / (up.log10() - low.log10()));
    let name = format!("RMSE [{unit}], logarithmic");
    d.text(x0, top - 30.0, 15.0, colors::INK, Anchor::Start, &name);
    let mut tick = low;
    while tick <= up * 1.001 {
        d.line([x0, y(tick)], [x0 + wide, y(tick)], Ink(colors::GRID, 1.0));
        let digits = (-tick.log10().floor()).max(0.0) as usize;
        let label = format!("{tick:.digits$}");
        d.text(x0 - 8.0, y(tick) + 4.5, 13.0, colors::SOFT, Anchor::End, &label);
        tick *= 10.0;
    }
    d.line([x0, base], [x0 + wide, base], Ink(colors::AXIS, 1.0));
    let (group, step) = (wide / 3.0, 48.0);
    let bars = step * errors.len() as f64;
    for (k, axis) in axes.into_iter().enumerate() {
        let first = x0 + group * k as f64 + 0.5 * (group - bars);
        for (j, (column, e)) in errors.iter().enumerate() {
            let (v, x) = (e.rmse[axis], first + step * j as f64);
            d.bar(x, y(v), 36.0, base - y(v), column.color);
            let digits = match v {
                v if v >= 100.0 => 0,
                v if v >= 10.0 => 1,
                v if v >= 0.1 => 2,
                _ => 3,
            };
            let label = format!("{v:.digits$}");
            d.text(x + 18.0, y(v) - 6.0, 13.0, colors::SOFT, Anchor::Middle, &label);
        }
        let middle = first + 0.5 * bars - 6.0;
        d.text(middle, base + 24.0, 15.0, colors::INK, Anchor::Middle, AXES[axis]);
    }
}

/// Powers of ten around the errors of these axes, the lower one with space for a bar.
fn decades(errors: &[(&Column, Errors)], axes: [usize; 3]) -> [f64; 2] {
    let values = || {
        errors
            .iter()
            .flat_map(|(_, e)| axes.map(|a| e.rmse[a]))
            .filter(|v| *v > 0.0 && v.is_finite())
    };
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
    if low > high {
        return [0.1, 10.0];
    }
    [10f64.powf((low * 0.5).log10().floor()), 10f64.powf(high.log10().ceil())]
}
