//! Horizontal bars in panels with the same rows.

use volant::report::{Anchor, Axis, Color, Drawing, Ink, colors};

/// A panel.
pub(super) struct Bars {
    pub axis: Axis,
    /// Length of the bar of each row.
    pub values: Vec<f64>,
    /// Half length of the whisker of each row; empty without whiskers.
    pub spread: Vec<f64>,
}

/// Draws panels, `across` beside one another, with a bar for each of `rows`: its name and color.
pub(super) fn draw_bars(
    title: &str,
    rows: &[(String, Color)],
    across: usize,
    panels: &[Bars],
) -> String {
    const ROW: f64 = 34.0;
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, title);
    // A generous mean width of the letters.
    let letters = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let left = 40.0 + 7.6 * letters as f64;
    let (step, high) = ((1110.0 - left) / across as f64, ROW * rows.len() as f64);
    for (i, panel) in panels.iter().enumerate() {
        let (x0, wide) = (left + step * (i % across) as f64, step - 70.0);
        let top = 92.0 + (high + 76.0) * (i / across) as f64;
        let ([low, up], log) = (panel.axis.range, panel.axis.log);
        let x = |v: f64| {
            let share = if log { (v / low).ln() / (up / low).ln() } else { (v - low) / (up - low) };
            x0 + wide * share.clamp(0.0, 1.0)
        };
        d.text(x0, top - 14.0, 15.0, colors::INK, Anchor::Start, &panel.axis.name);
        let ticks = if log { (up / low).log10().round() as i32 } else { 4 };
        for k in 0..=ticks {
            let part = f64::from(k) / f64::from(ticks);
            let v = if log { low * 10f64.powi(k) } else { low + (up - low) * part };
            let color = if k == 0 { colors::AXIS } else { colors::GRID };
            d.line([x(v), top - 6.0], [x(v), top + high], Ink(color, 1.0));
            // Of many decades every other one has its number.
            if ticks <= 4 || k % 2 == 0 {
                d.text(x(v), top + high + 18.0, 13.0, colors::SOFT, Anchor::Middle, &number(v));
            }
        }
        for (k, (name, color)) in rows.iter().enumerate() {
            let y = top + ROW * k as f64;
            if i % across == 0 {
                d.text(left - 16.0, y + 18.0, 14.0, colors::INK, Anchor::End, name);
            }
            let v = panel.values[k];
            if !v.is_finite() {
                d.text(x0 + 6.0, y + 18.0, 13.0, colors::SOFT, Anchor::Start, "–");
                continue;
            }
            d.bar(x0, y, x(v) - x0, 26.0, *color);
            let mut end = x(v);
            if let Some(spread) = panel.spread.get(k) {
                let ends = [x(v - spread), x(v + spread)];
                d.line([ends[0], y + 13.0], [ends[1], y + 13.0], Ink(colors::INK, 1.5));
                for at in ends {
                    d.line([at, y + 8.0], [at, y + 18.0], Ink(colors::INK, 1.5));
                }
                end = ends[1];
            }
            d.text(end + 6.0, y + 18.0, 13.0, colors::SOFT, Anchor::Start, &number(v));
        }
    }
    d.finish(92.0 + (high + 76.0) * panels.len().div_ceil(across) as f64, title)
}

/// Powers of ten around values, the lower one with space for a bar.
pub(super) fn decades(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let [low, high] = values
        .filter(|v| *v > 0.0 && v.is_finite())
        .fold([f64::INFINITY, 0.0], |[low, high], v| [low.min(v), high.max(v)]);
    if low > high {
        return [0.1, 10.0];
    }
    [10f64.powf((low * 0.5).log10().floor()), 10f64.powf(high.log10().ceil())]
}

/// Formats a number with three digits, without trailing zeros.
fn number(v: f64) -> String {
    let k = 10f64.powf(2.0 - v.abs().max(1e-9).log10().floor());
    ((v * k).round() / k).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits_and_decades_contain_the_values() {
        let shown = [0.0, 0.1, 7.2749, 0.042_17, 1234.0].map(number);
        assert_eq!(shown, ["0", "0.1", "7.27", "0.0422", "1230"]);
        let [low, up] = decades([3.0, f64::NAN, 0.0, 120.0].into_iter());
        assert!((low - 1.0).abs() < 1e-9 && (up - 1000.0).abs() < 1e-9, "{low} {up}");
    }
}
