//! The whole image in one pass: patches of the markers' hues, by runs of like colour on every `stride`-th row and column.

use crate::{image::ImageView, signal::rgb_at};
use nalgebra::{Matrix2, Vector2};
use rig_model::{MarkerColor, PerColor};
use wide::{f32x4, i32x4, u8x16, u32x4};

/// A patch of one colour.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blob {
    pub color: MarkerColor,
    pub centroid: Vector2<f64>,
    /// px² of the full image.
    pub area: f64,
    /// Second central moments, px².
    pub spread: Matrix2<f64>,
    pub rgb: [f32; 3],
    /// True where it touches the image's edge.
    pub cut: bool,
}

impl Blob {
    /// Area over that of the parallelogram with the same second moments: 1 for a parallelogram, 1.05 for an ellipse,
    /// less for what has holes, arms or a bent outline.
    pub fn fill(&self) -> f64 {
        self.area / (12.0 * self.spread.determinant().max(1e-6).sqrt())
    }

    /// Share of the brightness that is colour, 0 to 1.
    pub fn saturation(&self) -> f32 {
        let max = self.rgb.iter().fold(1.0f32, |m, v| m.max(*v));
        let min = self.rgb.iter().fold(max, |m, v| m.min(*v));
        (max - min) / max
    }

    /// Ratio of the principal extents, ≥ 1.
    pub fn elongation(&self) -> f64 {
        let (t, d) = (self.spread.trace(), self.spread.determinant());
        let root = (t * t / 4.0 - d).max(0.0).sqrt();
        ((t / 2.0 + root) / (t / 2.0 - root).max(1e-3)).sqrt()
    }
}

/// Which marker's hue a pixel has, with how much of its brightness is colour (0 to 1). The four measures are the paper's
/// layer differences, each taken against the stronger of the layers that it has to be free of.
#[inline(always)]
fn classify([r, g, b]: [u8; 3]) -> Option<(MarkerColor, i32, i32)> {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    let max = r.max(g).max(b);
    let (color, layer) = if r >= g && g >= b {
        // Between red and yellow; orange (hue 30°) is where they meet.
        if 2 * (g - b) >= r - b { (MarkerColor::Yellow, g - b) } else { (MarkerColor::Red, r - g) }
    } else if r >= g {
        (MarkerColor::Red, r - g.max(b))
    } else if g >= b {
        // Yellow-green (hue 75°) is where yellow meets green.
        if 4 * (r - b) >= 3 * (g - b) {
            (MarkerColor::Yellow, r - b)
        } else {
            (MarkerColor::Green, g - r.max(b))
        }
    } else {
        (MarkerColor::Blue, b - g.max(r))
    };
    (layer > 0).then_some((color, layer, max))
}

/// How a pixel's colour names a marker: by the hues that the markers' names say, or by those of calibrated paper.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Palette {
    /// Unit vectors of the markers' hues.
    hues: Option<[[f32; 2]; 4]>,
}

impl Palette {
    /// cos 40°: further off than that it is none of them.
    const FURTHEST: f32 = 0.766;
    /// Ordinary paper, for a marker that was not calibrated beside others that were.
    const ORDINARY: [[f64; 3]; 4] =
        [[200.0, 40.0, 40.0], [50.0, 170.0, 70.0], [40.0, 90.0, 190.0], [210.0, 190.0, 50.0]];

    /// Of calibrated mean colours, r, g, b of 0–255.
    pub fn new(colors: &PerColor<Option<[f64; 3]>>) -> Self {
        let any = colors.0.iter().any(Option::is_some);
        Self {
            hues: any.then(|| {
                std::array::from_fn(|i| {
                    let [a, b] = chroma(colors.0[i].unwrap_or(Self::ORDINARY[i]).map(|v| v as f32));
                    let length = a.hypot(b).max(1e-6);
                    [a / length, b / length]
                })
            }),
        }
    }

    /// As [`classify`].
    #[inline(always)]
    pub fn classify(&self, rgb: [u8; 3]) -> Option<(MarkerColor, i32, i32)> {
        let Some(hues) = &self.hues else { return classify(rgb) };
        let [a, b] = chroma(rgb.map(f32::from));
        let along = hues.map(|h| h[0] * a + h[1] * b);
        let mut best = 0;
        for i in 1..4 {
            if along[i] > along[best] {
                best = i;
            }
        }
        if along[best] <= 0.0 || along[best].powi(2) < Self::FURTHEST.powi(2) * (a * a + b * b) {
            return None;
        }
        let (max, min) = (rgb[0].max(rgb[1]).max(rgb[2]), rgb[0].min(rgb[1]).min(rgb[2]));
        Some((MarkerColor::ALL[best], i32::from(max - min), i32::from(max)))
    }
}

/// A colour's part across the grey axis: its direction is the hue.
#[inline(always)]
fn chroma([r, g, b]: [f32; 3]) -> [f32; 2] {
    [2.0 * r - g - b, 1.732_050_8 * (g - b)]
}

#[derive(Clone, Copy, Debug)]
struct Run {
    color: MarkerColor,
    start: u32,
    end: u32,
    label: u32,
    sum: [f32; 3],
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    rgb: [f64; 3],
    cut: bool,
}

/// Distance of the coarse grid's places, and side of the cells that it marks, px.
const GRID: usize = 4;
pub(crate) const CELL: usize = 8;

/// What counts as coloured, in whole numbers.
#[derive(Clone, Copy)]
struct Tint {
    layer: i32,
    /// Of 256.
    saturation: i32,
}

impl Tint {
    fn new(config: &ScanConfig) -> Self {
        Self { layer: config.min_layer, saturation: (config.min_saturation * 256.0) as i32 }
    }

    /// Whether a pixel's channels differ enough; most of a picture is left by this test.
    #[inline(always)]
    fn is_colored(&self, [a, b, c]: [u8; 3]) -> bool {
        let (max, min) = (a.max(b).max(c), a.min(b).min(c));
        self.is_layer(i32::from(max - min), i32::from(max))
    }

    /// Which of four pixels are coloured, a bit for each; their fourth bytes are not looked at.
    #[inline(always)]
    fn are_colored(&self, pixels: [u32; 4]) -> u32 {
        let a = u32x4::new(pixels);
        // Each word's lowest byte is compared with the two above it.
        let [a, b, c]: [u8x16; 3] = [bytemuck::cast(a), bytemuck::cast(a >> 8), bytemuck::cast(a >> 16)];
        let number = |bytes: u8x16| {
            let lowest: i32x4 = bytemuck::cast(bytemuck::cast::<u8x16, u32x4>(bytes) & u32x4::splat(0xff));
            lowest.round_float()
        };
        let (max, min) = (number(a.max(b).max(c)), number(a.min(b).min(c)));
        let layer = max - min;
        let saturated = (layer * f32x4::splat(256.0)).simd_ge(max * f32x4::splat(self.saturation as f32));
        (layer.simd_ge(f32x4::splat(self.layer as f32)) & saturated).to_bitmask()
    }

    #[inline(always)]
    fn is_layer(&self, layer: i32, max: i32) -> bool {
        (layer >= self.layer) & (layer * 256 >= self.saturation * max)
    }
}

/// Memory of the scan, kept from one image to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scanner {
    above: Vec<Run>,
    here: Vec<Run>,
    parent: Vec<u32>,
    sums: Vec<(MarkerColor, Sums)>,
    seeds: Vec<bool>,
    cells: Vec<bool>,
    pub palette: Palette,
    pub blobs: Vec<Blob>,
}

/// What a pixel must have to belong to a patch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanConfig {
    pub stride: usize,
    /// Distance along a row of the places that are asked first whether anything is coloured there, px.
    pub grid: usize,
    /// Least share of the brightness that is colour.
    pub min_saturation: f32,
    /// Least layer difference of 255.
    pub min_layer: i32,
    /// Smallest and largest patch, px².
    pub min_area: f64,
    pub max_area: f64,
}

impl Scanner {
    /// That tells colours by this palette.
    pub fn new(palette: Palette) -> Self {
        Self { palette, ..Self::default() }
    }

    fn root(&mut self, mut label: u32) -> u32 {
        while self.parent[label as usize] != label {
            let up = self.parent[self.parent[label as usize] as usize];
            self.parent[label as usize] = up;
            label = up;
        }
        label
    }

    /// Finds the patches of the rectangle `[x0, x1) × [y0, y1)`; they are in `self.blobs` afterwards.
    pub fn scan(&mut self, image: &ImageView<'_>, [x0, y0, x1, y1]: [i32; 4], config: &ScanConfig) {
        self.blobs.clear();
        self.sums.clear();
        self.parent.clear();
        self.above.clear();
        let stride = config.stride.max(1);
        let (x0, y0) = (x0.clamp(0, image.width as i32) as usize, y0.clamp(0, image.height as i32) as usize);
        let (x1, y1) = (x1.clamp(0, image.width as i32) as usize, y1.clamp(0, image.height as i32) as usize);
        if x1 <= x0 || y1 <= y0 {
            return;
        }
        self.mark_cells(image, [x0, y0, x1, y1], config);
        let bytes = image.format.bytes_per_pixel();
        let blue_first = image.format.blue_first();
        let tint = Tint::new(config);
        let palette = self.palette;
        for y in (y0..y1).step_by(stride) {
            self.here.clear();
            let Some(row) = image.data.get(y * image.step + x0 * bytes..y * image.step + x1 * bytes) else {
                break;
            };
            let columns = (x1 - x0).div_ceil(CELL);
            let cells = (y - y0) / CELL * columns;
            let mut column = 0;
            while let Some(from) = self.cells[cells..cells + columns].iter().skip(column).position(|c| *c) {
                let from = column + from;
                let length = self.cells[cells + from..cells + columns]
                    .iter()
                    .position(|c| !*c)
                    .unwrap_or(columns - from);
                column = from + length;
                // The first of the grid's places in these cells.
                let (start, end) = ((from * CELL).next_multiple_of(stride), (column * CELL).min(x1 - x0));
                if start >= end {
                    continue;
                }
                let mut open: Option<Run> = None;
                for (i, pixel) in row[start * bytes..end * bytes].chunks(bytes * stride).enumerate() {
                    let &[a, b, c, ..] = pixel else { break };
                    let x = (x0 + start + i * stride) as u32;
                    let rgb = if blue_first { [c, b, a] } else { [a, b, c] };
                    let class = if tint.is_colored(rgb) {
                        palette
                            .classify(rgb)
                            .filter(|&(_, layer, max)| tint.is_layer(layer, max))
                            .map(|(color, ..)| color)
                    } else {
                        None
                    };
                    match (class, &mut open) {
                        (None, None) => {}
                        (Some(color), Some(run)) if run.color == color && alike(run, rgb.map(f32::from)) => {
                            run.end = x;
                            for (sum, value) in run.sum.iter_mut().zip(rgb) {
                                *sum += f32::from(value);
                            }
                        }
                        (class, open) => {
                            if let Some(run) = open.take() {
                                self.here.push(run);
                            }
                            *open = class.map(|color| Run {
                                color,
                                start: x,
                                end: x,
                                label: 0,
                                sum: rgb.map(f32::from),
                            });
                        }
                    }
                }
                if let Some(run) = open {
                    self.here.push(run);
                }
            }
            self.link(y, stride, x0, x1, y0, y1);
        }
        self.collect(stride, config);
    }

    /// Which cells are worth a closer look: those with a coloured pixel on a coarse grid, and their neighbours. Most of a
    /// picture is grey, and a patch that slips through the grid is smaller than any marker that can be measured.
    fn mark_cells(&mut self, image: &ImageView<'_>, [x0, y0, x1, y1]: [usize; 4], config: &ScanConfig) {
        let (columns, rows) = ((x1 - x0).div_ceil(CELL), (y1 - y0).div_ceil(CELL));
        self.seeds.clear();
        self.seeds.resize(columns * rows, false);
        let bytes = image.format.bytes_per_pixel();
        let tint = Tint::new(config);
        let (grid, along) = (config.stride.clamp(GRID, CELL), config.grid.clamp(1, CELL));
        let skipped = if along == CELL { CELL / 2 } else { 0 };
        for y in (y0 + grid / 2..y1).step_by(grid) {
            let start = y * image.step + x0 * bytes;
            let Some(row) = image.data.get(start..start + (x1 - x0) * bytes) else { break };
            let first = (y - y0) / CELL * columns;
            let seeds = &mut self.seeds[first..first + columns];
            let word = |cell: usize, x: usize| {
                let at = (cell * CELL + x) * bytes;
                match *row.get(at..at + 4).or_else(|| row.get(at..at + 3)).unwrap_or(&[]) {
                    // Which of the three is the red one makes no difference here.
                    [a, b, c, ..] => u32::from_le_bytes([a, b, c, 0]),
                    _ => 0,
                }
            };
            for (cell, seeds) in (0..).step_by(4).zip(seeds.chunks_mut(4)) {
                for x in (skipped..CELL).step_by(along) {
                    let [p, q, r, s] =
                        [word(cell, x), word(cell + 1, x), word(cell + 2, x), word(cell + 3, x)];
                    let colored = tint.are_colored([p, q, r, s]);
                    if colored != 0 {
                        for (i, seed) in seeds.iter_mut().enumerate() {
                            *seed |= colored >> i & 1 != 0;
                        }
                    }
                }
            }
        }
        self.cells.clear();
        self.cells.resize(columns * rows, false);
        for (i, _) in self.seeds.iter().enumerate().filter(|(_, seed)| **seed) {
            let (row, column) = (i / columns, i % columns);
            for r in row.saturating_sub(1)..(row + 2).min(rows) {
                let from = r * columns + column.saturating_sub(1);
                self.cells[from..(r * columns + (column + 2).min(columns))].fill(true);
            }
        }
    }

    fn link(&mut self, y: usize, stride: usize, x0: usize, x1: usize, y0: usize, y1: usize) {
        let mut first = 0;
        for index in 0..self.here.len() {
            let run = self.here[index];
            let n = ((run.end - run.start) as usize / stride + 1) as f32;
            let mean = run.sum.map(|s| s / n);
            while first < self.above.len() && self.above[first].end < run.start {
                first += 1;
            }
            let mut label = None;
            let mut j = first;
            while j < self.above.len() && self.above[j].start <= run.end {
                let other = self.above[j];
                if other.color == run.color && alike(&other, mean) {
                    let root = self.root(other.label);
                    label = Some(match label {
                        None => root,
                        Some(mine) if mine != root => {
                            let (low, high) = (root.min(mine), root.max(mine));
                            self.parent[high as usize] = low;
                            low
                        }
                        Some(mine) => mine,
                    });
                }
                j += 1;
            }
            let label = label.unwrap_or_else(|| {
                let new = self.parent.len() as u32;
                self.parent.push(new);
                self.sums.push((run.color, Sums::default()));
                new
            });
            self.here[index].label = label;
            let s = &mut self.sums[label as usize].1;
            let (a, b, n) = (f64::from(run.start), f64::from(run.end), f64::from(n));
            let mean_x = (a + b) / 2.0;
            // Σx² of n places a, a + stride, …, b.
            let spread = (stride * stride) as f64 * (n * n - 1.0) / 12.0;
            let yf = y as f64;
            s.n += n;
            s.x += n * mean_x;
            s.y += n * yf;
            s.xx += n * (mean_x * mean_x + spread);
            s.xy += n * mean_x * yf;
            s.yy += n * yf * yf;
            for c in 0..3 {
                s.rgb[c] += f64::from(run.sum[c]);
            }
            s.cut |= (run.start as usize) < x0 + stride
                || run.end as usize + stride >= x1
                || y < y0 + stride
                || y + stride >= y1;
        }
        std::mem::swap(&mut self.above, &mut self.here);
    }

    fn collect(&mut self, stride: usize, config: &ScanConfig) {
        for label in (0..self.sums.len()).rev() {
            let root = self.root(label as u32) as usize;
            if root != label {
                let s = self.sums[label].1;
                let r = &mut self.sums[root].1;
                r.n += s.n;
                r.x += s.x;
                r.y += s.y;
                r.xx += s.xx;
                r.xy += s.xy;
                r.yy += s.yy;
                for c in 0..3 {
                    r.rgb[c] += s.rgb[c];
                }
                r.cut |= s.cut;
                self.sums[label].1.n = 0.0;
            }
        }
        let cell = (stride * stride) as f64;
        for (color, s) in &self.sums {
            let area = s.n * cell;
            if s.n < 6.0 || area < config.min_area || area > config.max_area {
                continue;
            }
            let (mx, my) = (s.x / s.n, s.y / s.n);
            // The cells' own extent belongs to the moments.
            let own = cell / 12.0;
            self.blobs.push(Blob {
                color: *color,
                centroid: Vector2::new(mx, my),
                area,
                spread: Matrix2::new(
                    s.xx / s.n - mx * mx + own,
                    s.xy / s.n - mx * my,
                    s.xy / s.n - mx * my,
                    s.yy / s.n - my * my + own,
                ),
                rgb: s.rgb.map(|c| (c / s.n) as f32),
                cut: s.cut,
            });
        }
    }
}

/// Whether a colour continues a run: by less than a quarter of the brightness in each channel.
#[inline(always)]
fn alike(run: &Run, rgb: [f32; 3]) -> bool {
    // The run's first pixel is a blurred one, so compare with the brightest channel's scale; without a division.
    let n = run.sum[0].max(run.sum[1]).max(run.sum[2]).max(1.0);
    let m = rgb[0].max(rgb[1]).max(rgb[2]);
    let limit = (0.25 * m).max(20.0) * n;
    (0..3).all(|c| (run.sum[c] * m - rgb[c] * n).abs() < limit)
}

/// Mean colour over a few pixels about a place, or `None` outside.
pub(crate) fn mean_rgb(image: &ImageView<'_>, at: Vector2<f64>, radius: i32) -> Option<[f32; 3]> {
    let (cx, cy) = (at.x.round() as i32, at.y.round() as i32);
    let mut sum = [0f32; 3];
    let mut n = 0f32;
    for y in cy - radius..=cy + radius {
        for x in cx - radius..=cx + radius {
            if let Some(p) = rgb_at(image, x, y) {
                for c in 0..3 {
                    sum[c] += f32::from(p[c]);
                }
                n += 1.0;
            }
        }
    }
    (n > 0.0).then(|| sum.map(|s| s / n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibrated_palette_tells_hues_that_the_names_do_not() {
        let ordinary = Palette::default();
        let name = |p: &Palette, rgb| p.classify(rgb).map(|c| c.0);
        for (i, rgb) in Palette::ORDINARY.iter().enumerate() {
            assert_eq!(name(&ordinary, rgb.map(|v| v as u8)), Some(MarkerColor::ALL[i]));
        }
        // Turquoise paper for blue, orange for red.
        let (turquoise, orange) = ([40.0, 170.0, 160.0], [220.0, 120.0, 40.0]);
        let colors = PerColor([Some(orange), None, Some(turquoise), None]);
        let calibrated = Palette::new(&colors);
        assert_eq!(name(&ordinary, [40, 170, 160]), Some(MarkerColor::Green));
        assert_eq!(name(&calibrated, [40, 170, 160]), Some(MarkerColor::Blue));
        assert_eq!(name(&ordinary, [220, 120, 40]), Some(MarkerColor::Red));
        assert_eq!(name(&calibrated, [220, 120, 40]), Some(MarkerColor::Red));
        assert_eq!(name(&calibrated, [200, 30, 160]), None);
    }
}
