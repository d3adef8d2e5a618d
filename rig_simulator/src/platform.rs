//! The platform: plate with four squares, fans and hook, as flat pieces in the volant frame.

use crate::{
    floor::{Colour, circle, rectangle},
    random::Random,
};
use nalgebra::Point3;
use rig_model::{MarkerLayout, PerColor};

/// A flat piece of one color, bordered by closed contours (m, volant frame); holes have the
/// opposite orientation.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Contours, with corners close enough that a lens bends no edge visibly.
    pub contours: Vec<Vec<Point3<f64>>>,
    /// Color in full light.
    pub colour: Colour,
    /// How much the surface varies, relative.
    pub grain: f32,
}

/// The platform.
#[derive(Clone, Debug)]
pub struct Platform {
    /// From the lowest to the uppermost.
    pub pieces: Vec<Piece>,
    /// Attachment point of the rope, volant frame.
    pub hook: Point3<f64>,
}

/// No edge is longer than this, m.
const EDGE: f64 = 0.02;

fn piece(flat: Vec<Vec<[f64; 2]>>, z: f64, colour: Colour, grain: f32) -> Piece {
    let contours = flat
        .into_iter()
        .map(|contour| {
            let mut fine = Vec::new();
            for (i, a) in contour.iter().enumerate() {
                let b = contour[(i + 1) % contour.len()];
                let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                let parts = (length / EDGE).ceil().max(1.0) as usize;
                for k in 0..parts {
                    let t = k as f64 / parts as f64;
                    fine.push(Point3::new(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), z));
                }
            }
            fine
        })
        .collect();
    Piece { contours, colour, grain }
}

fn frame(outer: Vec<[f64; 2]>, mut inner: Vec<[f64; 2]>) -> Vec<Vec<[f64; 2]>> {
    inner.reverse();
    vec![outer, inner]
}

/// A square of half side `a` whose corners are rounded by `r`.
fn rounded(center: [f64; 2], a: f64, r: f64) -> Vec<[f64; 2]> {
    let mut corners = Vec::new();
    for (quadrant, (sx, sy)) in
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].into_iter().enumerate()
    {
        for step in 0..=6 {
            let angle = std::f64::consts::FRAC_PI_2 * (quadrant as f64 + f64::from(step) / 6.0);
            corners.push([
                center[0] + sx * (a - r) + r * angle.cos(),
                center[1] + sy * (a - r) + r * angle.sin(),
            ]);
        }
    }
    corners
}

impl Platform {
    /// Builds the platform around the markers of `layout`, in `colours`; the squares' yaw comes
    /// from the seed.
    pub fn new(layout: &MarkerLayout, colours: &[Colour; 4], seed: u64) -> Self {
        let mut random = Random::fork(seed, "platform");
        let reach =
            layout.centers.iter().map(|(_, c)| c.x.abs().max(c.y.abs())).fold(0.0, f64::max);
        let top = layout.centers.iter().map(|(_, c)| c.z).fold(f64::INFINITY, f64::min);
        let half = reach + layout.side / 2.0 + 0.035;
        let plate = random.within(138.0, 162.0) as f32;
        let grey = |v: f32| [v, v, v * 1.02];
        let mut pieces = Vec::new();
        let mut add = |contours: Vec<Vec<[f64; 2]>>, z, colour, grain| {
            pieces.push(piece(contours, z, colour, grain));
        };
        for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
            let center = [x * (half + 0.05), y * (half + 0.05)];
            let ring = frame(circle(center, 0.085, 40), circle(center, 0.076, 40));
            add(ring, top - 0.06, grey(52.0), 0.0);
            add(vec![rectangle(center, 0.9 * x + 0.3, 0.073, 0.007)], top - 0.06, grey(64.0), 0.0);
            add(vec![circle(center, 0.018, 20)], top - 0.06, grey(40.0), 0.0);
        }
        add(vec![rounded([0.0; 2], half, 0.03)], top, grey(plate), 0.05);
        let border =
            frame(rounded([0.0; 2], half - 0.008, 0.024), rounded([0.0; 2], half - 0.010, 0.023));
        add(border, top, grey(plate * 0.78), 0.0);
        let window = frame(rounded([0.0; 2], 0.088, 0.01), rounded([0.0; 2], 0.086, 0.009));
        add(window, top, grey(plate * 0.72), 0.0);
        for (x, y) in [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)] {
            let bolt = [x * (half - 0.018), y * (half - 0.018)];
            add(vec![circle(bolt, 0.005, 12)], top, grey(70.0), 0.0);
        }
        // Battery and label, on opposite sides between two markers each.
        add(vec![rectangle([0.0, -0.13], 0.02, 0.045, 0.028)], top, grey(46.0), 0.03);
        add(vec![rectangle([0.0, 0.13], -0.04, 0.05, 0.022)], top, grey(212.0), 0.0);
        for (i, (x, w)) in
            [(-0.036, 0.006), (-0.018, 0.008), (0.0, 0.004), (0.015, 0.008), (0.034, 0.006)]
                .into_iter()
                .enumerate()
        {
            let bar = rectangle([x, 0.131 + 0.002 * (i % 2) as f64], -0.04, w, 0.011);
            add(vec![bar], top, grey(60.0), 0.0);
        }
        // How each square is turned in its plane, rad: a few degrees that nobody measured.
        let turns = PerColor::from_fn(|_| random.within(-0.12, 0.12));
        for (color, center) in layout.centers.iter() {
            let h = layout.side / 2.0;
            let square = rectangle([center.x, center.y], turns[color], h, h);
            add(vec![square], center.z, colours[color.index()], 0.012);
        }
        let hook = Point3::new(0.0, 0.0, top + 0.09);
        for turn in [0.4, 0.4 + std::f64::consts::FRAC_PI_2] {
            add(vec![rectangle([0.0; 2], turn, 0.055, 0.006)], top + 0.03, grey(84.0), 0.0);
        }
        add(vec![circle([0.0; 2], 0.026, 32)], top + 0.05, grey(96.0), 0.0);
        add(vec![circle([0.0; 2], 0.012, 24)], hook.z, grey(120.0), 0.0);
        Self { pieces, hook }
    }
}
