//! Line and dot charts in panels, drawn by plotters.

use super::palette::{colors, finished};
use plotters::{
    coord::{Shift, ranged1d::ValueFormatter},
    prelude::*,
    style::FontDesc,
};
use thiserror::Error;

/// Why a figure is not drawn.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct ChartError(pub String);

impl<E: std::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for ChartError {
    fn from(error: DrawingAreaErrorKind<E>) -> Self {
        Self(error.to_string())
    }
}

/// Font of `size` px; plotters expects points of 1.24 px.
fn font(size: f64) -> FontDesc<'static> {
    ("sans-serif", 1.24 * size).into_font()
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Style of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A line of this width, px.
    Line(u32),
    /// Dots.
    Dots,
    /// A line with a dot at each value.
    Dotted,
    /// A line of this width with a whisker of the series' `spread` at each value.
    Whiskers(u32),
    /// Shaded spans of the x axis, below the grid: a point is a span's start and end.
    Spans,
}

impl Shape {
    /// Width of its line, px.
    fn width(self) -> u32 {
        match self {
            Self::Line(width) | Self::Whiskers(width) => width,
            Self::Dotted => 2,
            Self::Dots => 0,
            Self::Spans => 12,
        }
    }
}

/// Series of values.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Color.
    pub color: RGBColor,
    /// Style.
    pub shape: Shape,
    /// Points (x, y); a non-finite y leaves a gap.
    pub points: Vec<(f64, f64)>,
    /// Half length of each whisker; empty without whiskers.
    pub spread: Vec<f64>,
}

impl Series {
    /// A series without whiskers.
    pub fn new(
        name: impl Into<String>,
        color: RGBColor,
        shape: Shape,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        let points = points.into_iter().collect();
        Self { name: name.into(), color, shape, points, spread: vec![] }
    }
}

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Name and unit.
    pub name: String,
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// Whether the scale is logarithmic.
    pub log: bool,
}

impl Axis {
    /// Creates an axis.
    pub fn new(name: impl Into<String>, range: [f64; 2], log: bool) -> Self {
        Self { name: name.into(), range, log }
    }
}

/// One chart of a sheet.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Title; may be empty.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Series.
    pub series: Vec<Series>,
}

/// Layout of the panels.
#[derive(Clone, Copy, Debug)]
pub struct Sheet<'a> {
    /// Title.
    pub title: &'a str,
    /// Width and height, px.
    pub size: (u32, u32),
    /// Rows and columns of panels.
    pub grid: (usize, usize),
}

/// Draws panels with a common legend: each name of a series once, in the order of appearance.
///
/// # Errors
/// plotters fails.
pub fn panels(sheet: Sheet<'_>, panels: &[Panel]) -> Result<String, ChartError> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, sheet.size).into_drawing_area();
        root.fill(&colors::BACK)?;
        let mut names: Vec<&Series> = Vec::new();
        for series in panels.iter().flat_map(|p| &p.series) {
            if !series.name.is_empty() && !names.iter().any(|e| e.name == series.name) {
                names.push(series);
            }
        }
        let body = headed(&root, sheet.title, &names)?;
        for (panel, area) in panels.iter().zip(body.split_evenly(sheet.grid)) {
            draw_panel(&area, panel)?;
        }
        root.present()?;
    }
    Ok(finished(&svg, sheet.title))
}

/// Draws title and legend, in the lines they need; returns the area below.
fn headed<'a>(root: &Area<'a>, title: &str, entries: &[&Series]) -> Result<Area<'a>, ChartError> {
    const LINE: i32 = 26;
    let width = root.dim_in_pixel().0 as i32;
    // A generous mean width of the letters keeps entries apart in any font.
    let advance = |name: &str| 60 + (8.4 * name.chars().count() as f64) as i32;
    let (mut x, mut row) = (28, 0);
    let mut places = Vec::new();
    for entry in entries {
        if x > 28 && x + advance(&entry.name) > width - 10 {
            (x, row) = (28, row + 1);
        }
        places.push((x, row));
        x += advance(&entry.name);
    }
    let rows = if entries.is_empty() { 0 } else { row + 1 };
    let (head, body) = root.split_vertically(44 + LINE * rows);
    head.draw(&Text::new(title.to_owned(), (24, 14), font(20.0).color(&colors::INK)))?;
    for (entry, (x, row)) in entries.iter().zip(places) {
        let y = 54 + LINE * row;
        match entry.shape {
            Shape::Dots => {
                for i in 0..3 {
                    head.draw(&Circle::new((x + 4 + 8 * i, y), 2, entry.color.filled()))?;
                }
            }
            shape => {
                let style = entry.color.stroke_width(shape.width());
                head.draw(&PathElement::new(vec![(x, y), (x + 24, y)], style))?;
            }
        }
        if entry.shape == Shape::Dotted {
            head.draw(&Circle::new((x + 12, y), 4, entry.color.filled()))?;
        }
        let text = font(15.0).color(&colors::INK);
        head.draw(&Text::new(entry.name.clone(), (x + 32, y - 8), text))?;
    }
    Ok(body)
}

fn draw_panel(area: &Area<'_>, panel: &Panel) -> Result<(), ChartError> {
    let mut builder = ChartBuilder::on(area);
    builder.margin(10).margin_right(20).x_label_area_size(48).y_label_area_size(72);
    if !panel.title.is_empty() {
        builder.caption(&panel.title, font(16.0).color(&colors::INK));
    }
    let ([x0, x1], [y0, y1]) = (panel.x.range, panel.y.range);
    let (x, y) = (x0..x1, y0..y1);
    match (panel.x.log, panel.y.log) {
        (true, true) => fill(builder.build_cartesian_2d(x.log_scale(), y.log_scale())?, panel),
        (true, false) => fill(builder.build_cartesian_2d(x.log_scale(), y)?, panel),
        (false, true) => fill(builder.build_cartesian_2d(x, y.log_scale())?, panel),
        (false, false) => fill(builder.build_cartesian_2d(x, y)?, panel),
    }
}

fn fill<X, Y>(
    mut chart: ChartContext<'_, SVGBackend<'_>, Cartesian2d<X, Y>>,
    panel: &Panel,
) -> Result<(), ChartError>
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let [low, high] = panel.y.range;
    let span = high - low;
    let digits = if span < 0.05 {
        3
    } else if span < 0.6 {
        2
    } else if span < 6.0 {
        1
    } else {
        0
    };
    let label = |v: &f64| {
        if panel.y.log { number(*v) } else { format!("{v:.digits$}") }
    };
    for spans in panel.series.iter().filter(|s| s.shape == Shape::Spans) {
        chart.draw_series(
            spans.points.iter().map(|(from, to)| {
                Rectangle::new([(*from, low), (*to, high)], spans.color.filled())
            }),
        )?;
    }
    let across = panel.x.range[1] - panel.x.range[0];
    let x_digits = usize::from(across < 6.0);
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(colors::GRID)
        .axis_style(colors::AXIS)
        .x_labels(9)
        .y_labels(6)
        .x_desc(&panel.x.name)
        .y_desc(&panel.y.name)
        .axis_desc_style(font(14.0).color(&colors::INK))
        .label_style(font(13.0).color(&colors::SOFT))
        .x_label_formatter(&|v| if panel.x.log { number(*v) } else { format!("{v:.x_digits$}") })
        .y_label_formatter(&label)
        .draw()?;
    for series in panel.series.iter().filter(|s| s.shape != Shape::Spans) {
        // Values outside of the range are drawn at its border.
        let clip = |v: f64| v.clamp(low, high);
        let width = series.shape.width();
        let [first, last] = panel.x.range;
        let points: Vec<(f64, f64)> = series
            .points
            .iter()
            .copied()
            .filter(|p| p.0.is_nan() || (first..=last).contains(&p.0))
            .collect();
        if width > 0 {
            for part in points.split(|p| !p.1.is_finite()).filter(|p| p.len() > 1) {
                let points = part.iter().map(|p| (p.0, clip(p.1)));
                chart.draw_series(LineSeries::new(points, series.color.stroke_width(width)))?;
            }
        }
        if let Shape::Whiskers(_) = series.shape {
            for (p, s) in series.points.iter().zip(&series.spread).filter(|(p, _)| p.1.is_finite())
            {
                let ends = vec![(p.0, clip(p.1 - s)), (p.0, clip(p.1 + s))];
                chart.draw_series([PathElement::new(ends, series.color.stroke_width(1))])?;
            }
        }
        let radius = match series.shape {
            Shape::Line(_) | Shape::Spans => continue,
            Shape::Dots => 2,
            Shape::Dotted | Shape::Whiskers(_) => 4,
        };
        let finite = points.iter().filter(|p| p.1.is_finite());
        chart.draw_series(
            finite.map(|p| Circle::new((p.0, clip(p.1)), radius, series.color.filled())),
        )?;
    }
    Ok(())
}

/// Formats a number at a logarithmic axis, without trailing zeros.
fn number(v: f64) -> String {
    if v >= 1.0 {
        format!("{v:.0}")
    } else {
        format!("{v:.6}").trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_series_is_drawn_and_named_once_and_a_gap_stays_a_gap() {
        let series = |name: &str, shape| Series {
            name: name.into(),
            color: colors::FUSED,
            shape,
            points: vec![(0.0, 0.02), (1.0, 0.5), (2.0, f64::NAN), (3.0, 1.0), (4.0, 900.0)],
            spread: vec![0.01; 5],
        };
        let panel = |log| Panel {
            title: "a panel".into(),
            x: Axis::new("angle [deg]", [0.0, 4.0], false),
            y: Axis::new("error [mm]", [0.01, 10.0], log),
            series: vec![
                series("ours", Shape::Whiskers(2)),
                series("theirs", Shape::Dotted),
                series("dots", Shape::Dots),
            ],
        };
        let sheet = Sheet { title: "a sheet", size: (900, 500), grid: (1, 2) };
        let svg = panels(sheet, &[panel(false), panel(true)]).unwrap();
        assert_eq!(svg.matches("\ntheirs\n").count(), 1, "one legend for both panels");
        assert_eq!(svg.matches("error [mm]").count(), 2);
        assert!(svg.contains("viewBox=\"0 0 900 500\""), "it scales");
        // Two parts per line, two lines per panel, two panels; plus whiskers and the legend's
        // lines.
        assert!(svg.matches("<polyline").count() >= 8, "{}", svg.matches("<polyline").count());
        assert_eq!(number(0.01), "0.01");
        assert_eq!(number(1000.0), "1000");
    }
}
