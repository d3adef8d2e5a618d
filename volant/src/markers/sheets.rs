//! Layout of the sheets.

use super::{Align, Mark, Paper, Sheet};
use anyhow::{Result, bail};
use rig_model::{MarkerColor, Rig};

/// Margin that every printer leaves, mm.
const MARGIN: f64 = 12.0;
/// Space around a square for its labels, mm.
const ROOM: f64 = 8.0;
/// Height of a sheet's title and of the scale bar at its bottom, mm.
const HEAD: f64 = 22.0;
const FOOT: f64 = 24.0;
/// Length of the scale bar, mm.
const BAR: f64 = 100.0;

/// Recommended side of a square in the image at the largest distance, px: each edge then has some
/// 15 pixels that no corner disturbs.
const SIDE_IN_IMAGE: f64 = 20.0;
/// Focal lengths of the table without a camera, px: 640 px wide images of 77 to 30 degrees.
const FOCAL_LENGTHS: [f64; 4] = [400.0, 600.0, 800.0, 1200.0];
/// Distances of the table, m.
const DISTANCES: [f64; 8] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0];

/// Inks of the squares: saturated, and different in hue.
const INKS: [[u8; 3]; 4] = [[214, 24, 40], [0, 150, 64], [0, 84, 190], [255, 214, 0]];

impl Sheet {
    fn text(&mut self, at: [f64; 2], size: f64, text: impl Into<String>) {
        self.marks.push(Mark::Text { at, size, align: Align::Start, text: text.into() });
    }

    fn centered(&mut self, at: [f64; 2], size: f64, text: impl Into<String>) {
        self.marks.push(Mark::Text { at, size, align: Align::Middle, text: text.into() });
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2], width: f64) {
        self.marks.push(Mark::Line { from, to, width });
    }

    fn square(&mut self, center: [f64; 2], side: f64, color: MarkerColor) {
        let at = center.map(|c| c - side / 2.0);
        let color = INKS[color.index()];
        self.marks.push(Mark::Rectangle { at, size: [side; 2], color });
    }

    /// A bar of `length` mm with ten divisions.
    fn bar(&mut self, at: [f64; 2], length: f64, label: &str) {
        self.line(at, [at[0] + length, at[1]], 0.4);
        for i in 0..=10 {
            let x = at[0] + length * f64::from(i) / 10.0;
            let tick = if i % 5 == 0 { 4.0 } else { 2.0 };
            self.line([x, at[1]], [x, at[1] - tick], 0.25);
        }
        self.text([at[0], at[1] + 4.5], 3.5, label);
    }

    fn titled(title: &str) -> Self {
        let mut sheet = Self::default();
        sheet.text([MARGIN, MARGIN + 6.0], 6.0, title);
        sheet
    }
}

/// The sheets of a rig: squares, mounting drawing, advice. `focal_length` is the camera's, px.
///
/// # Errors
/// A square is larger than the paper.
pub fn sheets(rig: &Rig, paper: &Paper, focal_length: Option<f64>) -> Result<Vec<Sheet>> {
    let mut sheets = squares(rig, paper)?;
    sheets.push(drawing(rig, paper));
    sheets.push(advice(rig, paper, focal_length));
    Ok(sheets)
}

/// The four squares, as many on a sheet as fit.
fn squares(rig: &Rig, paper: &Paper) -> Result<Vec<Sheet>> {
    let side = 1e3 * rig.markers.side;
    let cell = side + 2.0 * ROOM;
    let free = [paper.width - 2.0 * MARGIN, paper.height - 2.0 * MARGIN - HEAD - FOOT];
    let fitting = free.map(|length| (length / cell + 1e-9).floor() as usize);
    if fitting.contains(&0) {
        let largest = free[0].min(free[1]) - 2.0 * ROOM;
        bail!(
            "a square of {side:.0} mm (markers.size) does not fit on {}, which takes {largest:.0} \
             mm: choose larger paper (--page a3), have the SVG printed by a print shop, or cut \
             the square from colored board",
            paper.name
        );
    }
    let columns = fitting[0].min(2);
    let rows = fitting[1].min(4 / columns);
    let mut sheets = vec![];
    for group in MarkerColor::ALL.chunks(columns * rows) {
        let title = format!("Volant markers: squares of {side:.1} mm");
        let mut sheet = Sheet::titled(&title);
        for (i, &color) in group.iter().enumerate() {
            let place = |index: usize, count: usize, free: f64, from: f64| {
                from + free * (index as f64 + 0.5) / count as f64
            };
            let center = [
                place(i % columns, columns, free[0], MARGIN),
                place(i / columns, rows, free[1], MARGIN + HEAD),
            ];
            sheet.square(center, side, color);
            let half = side / 2.0;
            // Cutting marks at the corners, and marks at the middle of each side.
            for (dx, dy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
                let corner = [center[0] + dx * half, center[1] + dy * half];
                let out = |axis: usize, by: f64| {
                    let mut p = corner;
                    p[axis] += by * if axis == 0 { dx } else { dy };
                    p
                };
                sheet.line(out(0, 2.0), out(0, 7.0), 0.15);
                sheet.line(out(1, 2.0), out(1, 7.0), 0.15);
            }
            for (dx, dy) in [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)] {
                let at = |by: f64| [center[0] + dx * (half + by), center[1] + dy * (half + by)];
                sheet.line(at(2.0), at(5.0), 0.15);
            }
            sheet.centered([center[0], center[1] - half - 8.0], 4.5, color.name());
        }
        let bottom = paper.height - MARGIN - 8.0;
        sheet.bar(
            [MARGIN, bottom],
            BAR,
            "100 mm: measure it. Print at 100 %, not \"fit to page\".",
        );
        sheets.push(sheet);
    }
    Ok(sheets)
}

/// Where the squares belong, seen from above (as the camera sees them): x to the right, y up.
fn drawing(rig: &Rig, paper: &Paper) -> Sheet {
    let mut sheet = Sheet::titled("Mounting: the platform from above, z towards you");
    let side = 1e3 * rig.markers.side;
    let places = rig.markers.centers.0.map(|c| [1e3 * c.x, 1e3 * c.y, 1e3 * c.z]);
    // The origin and all squares, with room for labels.
    let extent = |axis: usize| {
        let of = |sign: f64| {
            places.iter().map(|p| sign * p[axis] + 0.75 * side).fold(0.3 * side, f64::max)
        };
        [-of(-1.0), of(1.0)]
    };
    let (across, along) = (extent(0), extent(1));
    let below = 62.0;
    let free = [paper.width - 2.0 * MARGIN - 30.0, paper.height - 2.0 * MARGIN - HEAD - below];
    let scale = (free[0] / (across[1] - across[0])).min(free[1] / (along[1] - along[0]));
    let origin = [
        (paper.width - scale * (across[0] + across[1])) / 2.0,
        MARGIN + HEAD + (free[1] + scale * (along[0] + along[1])) / 2.0,
    ];
    let at = |x: f64, y: f64| [origin[0] + scale * x, origin[1] - scale * y];
    for (color, place) in MarkerColor::ALL.into_iter().zip(&places) {
        let center = at(place[0], place[1]);
        sheet.square(center, scale * side, color);
        for (dx, dy) in [(1.0, 0.0), (0.0, 1.0)] {
            let cross = |s: f64| [center[0] + s * dx * 2.0, center[1] + s * dy * 2.0];
            sheet.line(cross(-1.0), cross(1.0), 0.2);
        }
        let label = format!("{color} ({:.1}, {:.1}, {:.1})", place[0], place[1], place[2]);
        sheet.centered([center[0], center[1] + scale * side / 2.0 + 5.0], 3.6, label);
    }
    let reach = scale * 0.6 * across[1].min(along[1]).max(0.5 * side);
    let tips = [[origin[0] + reach, origin[1]], [origin[0], origin[1] - reach]];
    for (tip, name, turned) in [(tips[0], "x", false), (tips[1], "y", true)] {
        sheet.line(origin, tip, 0.5);
        for side in [-1.2, 1.2] {
            let barb =
                if turned { [tip[0] + side, tip[1] + 3.0] } else { [tip[0] - 3.0, tip[1] + side] };
            sheet.line(tip, barb, 0.5);
        }
        sheet.text([tip[0] + 1.8, tip[1] - 1.5], 4.5, name);
    }
    let frame = &rig.frames.volant;
    sheet.text([origin[0] + 2.0, origin[1] + 5.0], 3.4, format!("origin of frame {frame}"));
    let mut y = paper.height - MARGIN - below + 8.0;
    let mut say = |text: String| {
        sheet.text([MARGIN, y], 3.6, text);
        y += 5.2;
    };
    say("Centers in mm: x, y, z in the platform's frame, as in the rig file. Check with a tape:"
        .into());
    let name = |i: usize| MarkerColor::ALL[i].name();
    let apart = |a: usize, b: usize| {
        let squares: f64 = (0..3).map(|k| (places[a][k] - places[b][k]).powi(2)).sum();
        format!("{} - {}: {:.1} mm", name(a), name(b), squares.sqrt())
    };
    say(format!("{}      {}      {}", apart(0, 1), apart(1, 2), apart(2, 3)));
    say(format!("{}      diagonals {}      {}", apart(3, 0), apart(0, 2), apart(1, 3)));
    say("The squares lie parallel to the frame's x-y plane; their rotation in it does not matter."
        .into());
    say("Measure the mounted centers again and enter them in the rig file (m).".into());
    // A round length that fits.
    let lengths = [1000.0, 500.0, 200.0, 100.0, 50.0, 20.0, 10.0];
    let length = lengths.into_iter().find(|l| l * scale < 100.0).unwrap_or(5.0);
    let bottom = paper.height - MARGIN - 6.0;
    sheet.bar([MARGIN, bottom], length * scale, &format!("{length:.0} mm of the platform"));
    sheet
}

fn advice(rig: &Rig, paper: &Paper, focal_length: Option<f64>) -> Sheet {
    let mut sheet = Sheet::titled("Paper, light and size");
    let mut y = MARGIN + HEAD;
    for line in [
        "Matte paper or board: gloss mirrors lamps, and a white spot moves the measured center.",
        "Saturated, even colors, one per square. Set the printer to highest quality, no economy",
        "mode; colored board of four hues serves as well. Print all squares on the same day.",
        "Flat: glue the whole back to a plate; a bent square is not where its center was measured.",
        "A rim of the platform's own color (black, gray or white) of a quarter of the side around",
        "each square. Nothing else of these colors on the platform.",
        "Light from above, even, without flicker; lock exposure and white balance of the camera.",
        "Afterwards: `volant calibrate colors` measures the colors as the camera sees them.",
    ] {
        sheet.text([MARGIN, y], 4.0, line);
        y += 6.0;
    }
    y += 8.0;
    let side = 1e3 * rig.markers.side;
    sheet.text([MARGIN, y], 4.5, "Size over distance");
    y += 7.0;
    let focal: Vec<f64> = focal_length.map_or(FOCAL_LENGTHS.to_vec(), |f| vec![f]);
    let what = match focal_length {
        Some(_) => "f is this camera's focal length.",
        None => "f is the focal length in pixels: fx in camera_info; --camera FILE names yours.",
    };
    let lines = [
        format!("Side of these squares ({side:.1} mm) in the image and, in brackets, the smallest"),
        format!("square of {SIDE_IN_IMAGE:.0} px, which we recommend at the largest distance."),
        what.to_owned(),
    ];
    for line in lines {
        sheet.text([MARGIN, y], 3.8, line);
        y += 5.5;
    }
    y += 3.0;
    let width = (paper.width - 2.0 * MARGIN - 26.0) / focal.len() as f64;
    let column = |i: usize| MARGIN + 26.0 + width * i as f64;
    sheet.text([MARGIN, y], 3.8, "distance");
    for (i, f) in focal.iter().enumerate() {
        sheet.text([column(i), y], 3.8, format!("f = {f:.0} px"));
    }
    y += 2.0;
    sheet.line([MARGIN, y], [paper.width - MARGIN, y], 0.2);
    y += 5.5;
    for distance in DISTANCES {
        sheet.text([MARGIN, y], 3.8, format!("{distance:.1} m"));
        for (i, f) in focal.iter().enumerate() {
            let pixels = f * rig.markers.side / distance;
            let smallest = 1e3 * SIDE_IN_IMAGE * distance / f;
            let note = if pixels < SIDE_IN_IMAGE { " !" } else { "" };
            let cell = format!("{pixels:.0} px{note}  ({smallest:.0} mm)");
            sheet.text([column(i), y], 3.8, cell);
        }
        y += 5.5;
    }
    let note =
        format!("! below {SIDE_IN_IMAGE:.0} px: print larger squares, or use a longer lens.");
    sheet.text([MARGIN, y + 2.0], 3.8, note);
    sheet
}
