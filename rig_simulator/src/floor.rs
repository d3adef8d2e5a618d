//! The floor of the hall as one image seen from above: its material and the objects on it.

use crate::{coverage::Coverage, random::Random};

/// Cell size of the image, m; a pixel of the camera sees about 5 mm.
const CELL: f64 = 0.003;
/// Side of the square image, m; it is mirrored beyond.
const SIDE: f64 = 6.0;

/// Light gray values, 0 to 255, linear in light.
pub type Colour = [f32; 3];

/// Covers a share of a pixel with a color.
pub(super) fn blend(pixel: &mut Colour, colour: Colour, share: f32) {
    for (value, new) in pixel.iter_mut().zip(colour) {
        *value += share * (new - *value);
    }
}

/// What the floor is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Material {
    /// Fine-grained, bluish gray.
    Carpet,
    /// Brown planks.
    Wood,
    /// Light gray, with joints and stains.
    Concrete,
}

/// The image of the floor.
#[derive(Debug)]
pub struct Floor {
    cells: Vec<[u8; 4]>,
    n: usize,
}

impl Floor {
    /// Generates the floor from a seed; `clutter` adds distractors in these colors.
    pub fn new(seed: u64, material: Material, clutter: Option<&[Colour; 4]>) -> Self {
        let n = (SIDE / CELL) as usize;
        let mut painter =
            Painter { coverage: Coverage::new(n, n), values: ground(seed, material, n), n };
        painter.strew(&mut Random::fork(seed, "things"), clutter);
        let cells =
            painter.values.iter().map(|v| [v[0] as u8, v[1] as u8, v[2] as u8, 0]).collect();
        Self { cells, n }
    }

    /// Value at a place of the floor, m, between its cells.
    pub fn at(&self, x: f32, y: f32) -> Colour {
        let half = (SIDE / 2.0) as f32;
        let per_cell = (1.0 / CELL) as f32;
        let mirror = |v: f32| {
            let v = (v + half).abs();
            (if v >= SIDE as f32 { 2.0 * SIDE as f32 - v } else { v }).clamp(0.0, SIDE as f32)
                * per_cell
        };
        let (u, v) = (mirror(x), mirror(y));
        let (i, j) = ((u as usize).min(self.n - 2), (v as usize).min(self.n - 2));
        let (fu, fv) = (u - i as f32, v - j as f32);
        let at = j * self.n + i;
        let (a, b) = (&self.cells[at], &self.cells[at + 1]);
        let (c, d) = (&self.cells[at + self.n], &self.cells[at + self.n + 1]);
        std::array::from_fn(|k| {
            let top = f32::from(a[k]) + fu * (f32::from(b[k]) - f32::from(a[k]));
            let bottom = f32::from(c[k]) + fu * (f32::from(d[k]) - f32::from(c[k]));
            top + fv * (bottom - top)
        })
    }
}

/// Smooth noise: random values on a grid, interpolated.
#[derive(Debug)]
pub(super) struct Noise {
    values: Vec<f32>,
    n: usize,
}

impl Noise {
    pub(super) fn new(random: &mut Random, n: usize) -> Self {
        Self { values: (0..n * n).map(|_| random.within(-1.0, 1.0) as f32).collect(), n }
    }

    /// At grid coordinates, periodic.
    pub(super) fn at(&self, x: f32, y: f32) -> f32 {
        let (i, j) = (x.floor(), y.floor());
        let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
        let (fx, fy) = (smooth(x - i), smooth(y - j));
        let value = |di: i64, dj: i64| {
            let wrap = |k: i64| k.rem_euclid(self.n as i64) as usize;
            self.values[wrap(j as i64 + dj) * self.n + wrap(i as i64 + di)]
        };
        let top = value(0, 0) + fx * (value(1, 0) - value(0, 0));
        let bottom = value(0, 1) + fx * (value(1, 1) - value(0, 1));
        top + fy * (bottom - top)
    }
}

fn ground(seed: u64, material: Material, n: usize) -> Vec<Colour> {
    let mut random = Random::fork(seed, "ground");
    let noise = Noise::new(&mut random, 256);
    let tint: Vec<f32> = (0..1024).map(|_| random.within(0.78, 1.12) as f32).collect();
    let metre = |k: usize| k as f32 * CELL as f32;
    let mut values = Vec::with_capacity(n * n);
    for j in 0..n {
        for i in 0..n {
            let (x, y) = (metre(i), metre(j));
            let broad = noise.at(x * 1.3, y * 1.3) + 0.5 * noise.at(x * 4.1 + 7.0, y * 4.1);
            let fine = noise.at(x * 90.0, y * 90.0) + 0.7 * noise.at(x * 41.0, y * 43.0);
            let value: Colour = match material {
                Material::Carpet => {
                    let g = 1.0 + 0.04 * broad + 0.09 * fine;
                    [92.0 * g, 98.0 * g, 112.0 * g]
                }
                Material::Wood => {
                    let row = (y / 0.14) as usize;
                    let along = x + tint[row % 1024] * 3.0;
                    let plank = (along / 1.1) as usize;
                    let grain =
                        noise.at(x * 3.0 + row as f32 * 13.0, y * 70.0 + plank as f32 * 5.0);
                    let seam = (y / 0.14).fract() < 0.022 || (along / 1.1).fract() < 0.0028;
                    let g = tint[(row * 37 + plank * 11) % 1024]
                        * (1.0 + 0.10 * grain + 0.03 * fine)
                        * if seam { 0.6 } else { 1.0 };
                    [128.0 * g, 98.0 * g, 72.0 * g]
                }
                Material::Concrete => {
                    let joint = (x / 1.5).fract() < 0.006 || (y / 1.5).fract() < 0.006;
                    let g = (1.0 + 0.09 * broad + 0.05 * fine) * if joint { 0.7 } else { 1.0 };
                    [142.0 * g, 140.0 * g, 134.0 * g]
                }
            };
            values.push(value.map(|v| v.clamp(0.0, 255.0)));
        }
    }
    values
}

struct Painter {
    coverage: Coverage,
    values: Vec<Colour>,
    n: usize,
}

impl Painter {
    /// Paints a polygon given in meters.
    fn paint(&mut self, contours: &[Vec<[f64; 2]>], colour: Colour) {
        let cells: Vec<Vec<[f64; 2]>> = contours
            .iter()
            .map(|c| c.iter().map(|p| p.map(|v| (v + SIDE / 2.0) / CELL)).collect())
            .collect();
        let (values, n) = (&mut self.values, self.n);
        self.coverage.fill(&cells, |x, y, share| blend(&mut values[y * n + x], colour, share));
    }

    fn strew(&mut self, random: &mut Random, clutter: Option<&[Colour; 4]>) {
        let place = |random: &mut Random| [random.within(-2.6, 2.6), random.within(-2.6, 2.6)];
        for _ in 0..16 {
            self.cable(place(random), random);
        }
        for _ in 0..14 {
            let (center, turn) = (place(random), random.within(0.0, 6.3));
            match random.index(3) {
                0 => self.sheet(center, turn, random),
                1 => self.carton(center, turn, random),
                _ => {
                    let grey = random.within(35.0, 90.0) as f32;
                    let tint = random.within(-12.0, 12.0) as f32;
                    let (a, b) = (random.within(0.1, 0.3), random.within(0.1, 0.3));
                    self.paint(&[rectangle(center, turn, a, b)], [grey + tint, grey, grey - tint]);
                }
            }
        }
        for _ in 0..5 {
            self.sheet(place(random), random.within(0.0, 6.3), random);
        }
        let Some(colours) = clutter else { return };
        for i in 0..44 {
            let (center, turn) = (place(random), random.within(0.0, 6.3));
            let shade = random.within(0.75, 1.1) as f32;
            let colour = colours[i % 4]
                .map(|v| (v * shade + random.within(-14.0, 14.0) as f32).clamp(0.0, 255.0));
            let size = random.within(0.02, 0.085);
            match random.index(4) {
                0 => self.paint(&[circle(center, size, 32)], colour),
                1 => self.paint(
                    &[rectangle(center, turn, size, size * random.within(0.3, 2.5))],
                    colour,
                ),
                _ => self.paint(&[rectangle(center, turn, size, size)], colour),
            }
        }
    }

    fn cable(&mut self, start: [f64; 2], random: &mut Random) {
        let mut heading = random.within(0.0, 6.3);
        let mut bend = 0.0;
        let mut left = Vec::new();
        let mut right = Vec::new();
        let mut p = start;
        for _ in 0..30 + random.index(40) {
            bend = 0.85 * bend + random.within(-0.12, 0.12);
            heading += bend;
            p = [p[0] + 0.03 * heading.cos(), p[1] + 0.03 * heading.sin()];
            let side = [-heading.sin() * 0.006, heading.cos() * 0.006];
            left.push([p[0] + side[0], p[1] + side[1]]);
            right.push([p[0] - side[0], p[1] - side[1]]);
        }
        left.extend(right.into_iter().rev());
        self.paint(&[left], [38.0, 38.0, 40.0]);
    }

    /// A sheet of paper with lines of print.
    fn sheet(&mut self, center: [f64; 2], turn: f64, random: &mut Random) {
        self.paint(&[rectangle(center, turn, 0.105, 0.1485)], [205.0, 205.0, 203.0]);
        for line in 0..14 {
            let across = 0.125 - 0.018 * f64::from(line);
            let length = random.within(0.03, 0.08);
            let start = -0.08 + length;
            let at = [
                center[0] + start * turn.cos() - across * turn.sin(),
                center[1] + start * turn.sin() + across * turn.cos(),
            ];
            self.paint(&[rectangle(at, turn, length, 0.0035)], [95.0, 95.0, 98.0]);
        }
    }

    /// A closed carton with its tape.
    fn carton(&mut self, center: [f64; 2], turn: f64, random: &mut Random) {
        let (a, b) = (random.within(0.12, 0.24), random.within(0.1, 0.2));
        let shade = random.within(0.8, 1.1) as f32;
        self.paint(
            &[rectangle([center[0] + 0.02, center[1] - 0.03], turn, a, b)],
            [48.0, 42.0, 38.0],
        );
        self.paint(&[rectangle(center, turn, a, b)], [126.0 * shade, 98.0 * shade, 70.0 * shade]);
        self.paint(
            &[rectangle(center, turn, a, 0.025)],
            [104.0 * shade, 82.0 * shade, 58.0 * shade],
        );
    }
}

/// A rectangle of half sides `a`, `b`.
pub(super) fn rectangle(center: [f64; 2], turn: f64, a: f64, b: f64) -> Vec<[f64; 2]> {
    let (s, c) = turn.sin_cos();
    [(-a, -b), (a, -b), (a, b), (-a, b)]
        .map(|(x, y)| [center[0] + c * x - s * y, center[1] + s * x + c * y])
        .to_vec()
}

/// A circle as a polygon of `corners`.
pub(super) fn circle(center: [f64; 2], radius: f64, corners: usize) -> Vec<[f64; 2]> {
    (0..corners)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / corners as f64;
            [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()]
        })
        .collect()
}
