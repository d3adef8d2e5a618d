//! Finds patches in one pass over an image, by runs of like color on every `stride`-th row and
//! column.

use crate::{
    image::Pixels,
    scan::{Patch, ScanConfig, palette::Palette},
};
use nalgebra::{Matrix2, Vector2, Vector3};
use rig_model::MarkerColor;

/// Distance of the coarse grid's rows and side of the cells that it marks, px: a patch that slips
/// through the grid is smaller than the smallest marker that can be measured (9 px²).
const GRID: usize = 4;
pub(crate) const CELL: usize = 8;

/// Neighboring pixels of like color on one row.
#[derive(Clone, Copy, Debug)]
struct Run {
    color: MarkerColor,
    /// First and last column, px.
    start: u32,
    end: u32,
    label: u32,
    /// Σ r, g, b.
    sum: [f32; 3],
}

/// Moments and color of a patch.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    n: f64,
    place: Vector2<f64>,
    square: Matrix2<f64>,
    rgb: Vector3<f64>,
    cut: bool,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.n += other.n;
        self.place += other.place;
        self.square += other.square;
        self.rgb += other.rgb;
        self.cut |= other.cut;
    }
}

/// Finds patches; its memory is reused from image to image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scanner {
    above: Vec<Run>,
    here: Vec<Run>,
    parent: Vec<u32>,
    sums: Vec<(MarkerColor, Sums)>,
    seeds: Vec<bool>,
    cells: Vec<bool>,
    pub palette: Palette,
    /// Patches of the last scan.
    pub patches: Vec<Patch>,
}

impl Scanner {
    /// Creates a scanner with this palette.
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

    /// Finds the patches of the rectangle `[x0, x1) × [y0, y1)` (px) and stores them in `patches`.
    pub fn scan(&mut self, image: &Pixels<'_>, [x0, y0, x1, y1]: [i32; 4], config: &ScanConfig) {
        self.patches.clear();
        self.sums.clear();
        self.parent.clear();
        self.above.clear();
        let stride = config.stride.max(1);
        let [x0, x1] = [x0, x1].map(|x| x.clamp(0, image.width as i32) as usize);
        let [y0, y1] = [y0, y1].map(|y| y.clamp(0, image.height as i32) as usize);
        if x1 <= x0 || y1 <= y0 {
            return;
        }
        if let Some(coverage) = &image.coverage {
            coverage.read([x0, y0].map(|v| v as i32), [x1 - 1, y1 - 1].map(|v| v as i32));
        }
        self.mark_cells(image, [x0, y0, x1, y1], config);
        let bytes = image.format.bytes_per_pixel();
        let blue_first = image.format.blue_first();
        let palette = self.palette;
        for y in (y0..y1).step_by(stride) {
            self.here.clear();
            let Some(row) =
                image.data.get(y * image.step + x0 * bytes..y * image.step + x1 * bytes)
            else {
                break;
            };
            let columns = (x1 - x0).div_ceil(CELL);
            let cells = &self.cells[(y - y0) / CELL * columns..][..columns];
            let mut column = 0;
            for cells in cells.chunk_by(|a, b| a == b) {
                let start = (column * CELL).next_multiple_of(stride);
                column += cells.len();
                let end = (column * CELL).min(x1 - x0);
                if !cells[0] || start >= end {
                    continue;
                }
                let mut open: Option<Run> = None;
                for (i, pixel) in row[start * bytes..end * bytes].chunks(bytes * stride).enumerate()
                {
                    let &[a, b, c, ..] = pixel else { break };
                    let x = (x0 + start + i * stride) as u32;
                    let rgb = if blue_first { [c, b, a] } else { [a, b, c] };
                    let class = if config.is_colored(rgb) { palette.classify(rgb) } else { None };
                    let color = class.filter(|c| config.is_layer(c.layer, c.max)).map(|c| c.color);
                    match (color, &mut open) {
                        (None, None) => {}
                        (Some(color), Some(run))
                            if run.color == color && alike(run, rgb.map(f32::from)) =>
                        {
                            run.end = x;
                            for (sum, value) in run.sum.iter_mut().zip(rgb) {
                                *sum += f32::from(value);
                            }
                        }
                        (color, open) => {
                            self.here.extend(open.take());
                            *open = color.map(|color| Run {
                                color,
                                start: x,
                                end: x,
                                label: 0,
                                sum: rgb.map(f32::from),
                            });
                        }
                    }
                }
                self.here.extend(open);
            }
            self.link(y, stride, [x0, y0, x1, y1]);
        }
        self.collect(stride, config);
    }

    /// Marks the cells that are scanned: those with a colored pixel on a coarse grid, and their
    /// neighbors. Most of an image is gray.
    fn mark_cells(
        &mut self,
        image: &Pixels<'_>,
        [x0, y0, x1, y1]: [usize; 4],
        config: &ScanConfig,
    ) {
        let (columns, rows) = ((x1 - x0).div_ceil(CELL), (y1 - y0).div_ceil(CELL));
        self.seeds.clear();
        self.seeds.resize(columns * rows, false);
        let bytes = image.format.bytes_per_pixel();
        let (grid, along) = (config.stride.clamp(GRID, CELL), config.grid.clamp(1, CELL));
        let skipped = if along == CELL { CELL / 2 } else { 0 };
        for y in (y0 + grid / 2..y1).step_by(grid) {
            let start = y * image.step + x0 * bytes;
            let Some(row) = image.data.get(start..start + (x1 - x0) * bytes) else { break };
            let first = (y - y0) / CELL * columns;
            let seeds = &mut self.seeds[first..first + columns];
            for (seed, cell) in seeds.iter_mut().zip(row.chunks(CELL * bytes)) {
                let mut pixels = cell.chunks_exact(bytes).skip(skipped).step_by(along);
                // The order of the channels makes no difference here.
                *seed = *seed || pixels.any(|p| config.is_colored([p[0], p[1], p[2]]));
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

    /// Labels the runs of row `y` by the runs above, and adds them to their patches.
    fn link(&mut self, y: usize, stride: usize, [x0, y0, x1, y1]: [usize; 4]) {
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
            let (a, b, n) = (f64::from(run.start), f64::from(run.end), f64::from(n));
            let mean_x = (a + b) / 2.0;
            // Variance of the n places a, a + stride, …, b.
            let spread = (stride * stride) as f64 * (n * n - 1.0) / 12.0;
            let yf = y as f64;
            let (xx, xy, yy) = (n * (mean_x * mean_x + spread), n * mean_x * yf, n * yf * yf);
            self.sums[label as usize].1.add(&Sums {
                n,
                place: Vector2::new(n * mean_x, n * yf),
                square: Matrix2::new(xx, xy, xy, yy),
                rgb: run.sum.map(f64::from).into(),
                cut: (run.start as usize) < x0 + stride
                    || run.end as usize + stride >= x1
                    || y < y0 + stride
                    || y + stride >= y1,
            });
        }
        std::mem::swap(&mut self.above, &mut self.here);
    }

    /// Merges linked patches and keeps those of the right size.
    fn collect(&mut self, stride: usize, config: &ScanConfig) {
        for label in (0..self.sums.len()).rev() {
            let root = self.root(label as u32) as usize;
            if root != label {
                let merged = std::mem::take(&mut self.sums[label].1);
                self.sums[root].1.add(&merged);
            }
        }
        let cell = (stride * stride) as f64;
        for (color, s) in &self.sums {
            let area = s.n * cell;
            if s.n < 6.0 || area < config.min_area || area > config.max_area {
                continue;
            }
            let centroid = s.place / s.n;
            // With the second moment of a sampled cell itself.
            let spread = s.square / s.n - centroid * centroid.transpose()
                + Matrix2::identity() * (cell / 12.0);
            let rgb = s.rgb.map(|c| (c / s.n) as f32).into();
            self.patches.push(Patch { color: *color, centroid, area, spread, rgb, cut: s.cut });
        }
    }
}

/// Whether a color continues a run: each channel differs by less than a quarter of the brightness.
#[inline(always)]
fn alike(run: &Run, rgb: [f32; 3]) -> bool {
    // Relative to the brightest channel, since a run's first pixel is blurred; without a division.
    let n = run.sum[0].max(run.sum[1]).max(run.sum[2]).max(1.0);
    let m = rgb[0].max(rgb[1]).max(rgb[2]);
    let limit = (0.25 * m).max(20.0) * n;
    (0..3).all(|c| (run.sum[c] * m - rgb[c] * n).abs() < limit)
}
