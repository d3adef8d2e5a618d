//! Coverage of the image and of the board's attitudes by the views, and what is missing.
//! Computed from images alone, before a calibration exists: positions of the corners, size of the
//! board, and inequality of its opposite sides (its tilt).

use super::board::{Board, View};
use nalgebra::Vector2;
use std::fmt;

/// Columns and rows of the coverage map.
const MAP: (usize, usize) = (6, 4);
/// Wanted views, as many as the paper used.
const WANTED_VIEWS: usize = 40;
/// Wanted tilted views in each of four directions.
const WANTED_TILTED: usize = 3;
/// Relative difference of opposite sides of a board tilted by about 15°.
const TILTED: f64 = 0.06;

/// The accepted views.
#[derive(Clone, Debug, Default)]
pub struct Coverage {
    /// Corners per cell of the image.
    map: [usize; MAP.0 * MAP.1],
    /// [`signature`] of each view.
    seen: Vec<[f64; 5]>,
}

/// Center and size (shares of the image), and inequality of opposite sides, horizontally and
/// vertically.
fn signature(view: &View, board: &Board) -> [f64; 5] {
    let (w, h) = (f64::from(view.size.0), f64::from(view.size.1));
    let at = |column: i32, row: i32| {
        let p = view.corners.get((row * board.columns + column) as usize).unwrap_or_default();
        Vector2::new(f64::from(p.x), f64::from(p.y))
    };
    let (a, b) = (at(0, 0), at(board.columns - 1, 0));
    let (c, d) = (at(board.columns - 1, board.rows - 1), at(0, board.rows - 1));
    let center = (a + b + c + d) / 4.0;
    let diagonals = (c - a, d - b);
    let area = 0.5 * (diagonals.0.x * diagonals.1.y - diagonals.0.y * diagonals.1.x).abs();
    let inequality = |p: f64, q: f64| (p - q) / (0.5 * (p + q)).max(1e-9);
    let (rows, columns) =
        (inequality((b - a).norm(), (c - d).norm()), inequality((c - b).norm(), (d - a).norm()));
    // In the image's directions, independent of the board's rotation in the image: the rows'
    // lengths change along the board's columns, the columns' lengths along its rows.
    let unit = |v: Vector2<f64>| v.try_normalize(1e-9).unwrap_or_default();
    let (down, along) = (unit((d + c) - (a + b)), unit((b + c) - (a + d)));
    let gradient = down * rows + along * columns;
    [center.x / w, center.y / h, (area / (w * h)).sqrt(), gradient.x, gradient.y]
}

impl Coverage {
    /// Adds a view.
    pub fn add(&mut self, view: &View, board: &Board) {
        for p in view.corners.iter() {
            let cell = |value: f32, size: i32, cells: usize| {
                ((f64::from(value) / f64::from(size) * cells as f64).max(0.0) as usize)
                    .min(cells - 1)
            };
            self.map[cell(p.y, view.size.1, MAP.1) * MAP.0 + cell(p.x, view.size.0, MAP.0)] += 1;
        }
        self.seen.push(signature(view, board));
    }

    /// Views tilted away at the top, bottom, left, right.
    fn tilted(&self) -> [usize; 4] {
        // The lengths shrink along the depth gradient: positive if the far side is right or below.
        [(4, -1.0), (4, 1.0), (3, -1.0), (3, 1.0)]
            .map(|(i, sign)| self.seen.iter().filter(|view| sign * view[i] > TILTED).count())
    }

    /// Largest share of the image's width and height that a board fills.
    fn largest_share(&self) -> f64 {
        self.seen.iter().map(|view| view[2]).fold(0.0, f64::max)
    }

    /// Whether a view of a stream differs enough from the accepted ones.
    pub fn adds(&self, view: &View, board: &Board) -> bool {
        let new = signature(view, board);
        let scale = [1.0, 1.0, 1.0, 2.0, 2.0];
        self.seen.iter().all(|old| {
            let distance: f64 = (0..5).map(|i| scale[i] * (new[i] - old[i]).abs()).sum();
            distance > 0.12
        })
    }

    /// Missing views, one sentence each; empty if none is missing.
    pub fn missing(&self) -> Vec<String> {
        let mut missing = Vec::new();
        let views = self.seen.len();
        if views < WANTED_VIEWS {
            missing.push(format!(
                "{} more views (there are {views}, {WANTED_VIEWS} are wanted)",
                WANTED_VIEWS - views
            ));
        }
        for (name, count) in ["top", "bottom", "left", "right"].iter().zip(self.tilted()) {
            if count < WANTED_TILTED {
                missing.push(format!(
                    "{} with the board tilted by 20 to 45 deg so that its {name} side is the far \
                     one ({count} so far)",
                    if count == 0 {
                        "views".into()
                    } else {
                        format!("{} more views", WANTED_TILTED - count)
                    }
                ));
            }
        }
        let places: Vec<&str> = [
            ("the top left corner", 0, 0),
            ("the top right corner", MAP.0 - 1, 0),
            ("the bottom left corner", 0, MAP.1 - 1),
            ("the bottom right corner", MAP.0 - 1, MAP.1 - 1),
        ]
        .iter()
        .filter(|(_, x, y)| self.map[y * MAP.0 + x] == 0)
        .map(|(name, ..)| *name)
        .collect();
        if !places.is_empty() {
            missing.push(format!(
                "the board in {} of the image, where the distortion is largest",
                places.join(", ")
            ));
        }
        if self.largest_share() < 0.4 {
            missing
                .push("the board nearer to the camera, so that it fills half of the image".into());
        }
        missing
    }
}

impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let most = self.map.iter().copied().max().unwrap_or(0).max(1);
        writeln!(
            f,
            "coverage of the image by corners (. none, 1 few … 9 most), {} views:",
            self.seen.len()
        )?;
        for row in self.map.chunks(MAP.0) {
            let line: String = row
                .iter()
                .map(|&n| if n == 0 { ". ".into() } else { format!("{} ", (n * 9).div_ceil(most)) })
                .collect();
            writeln!(f, "  {line}")?;
        }
        let [top, bottom, left, right] = self.tilted();
        let largest = self.largest_share();
        let smallest = self.seen.iter().map(|view| view[2]).fold(largest, f64::min);
        write!(
            f,
            "tilted away: top {top}, bottom {bottom}, left {left}, right {right}; board fills \
             {:.0} to {:.0} % of the image's sides",
            100.0 * smallest,
            100.0 * largest
        )
    }
}
