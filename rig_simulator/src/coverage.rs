//! Coverage of each pixel by a polygon, exactly: the area of the polygon inside the pixel's square.
//!
//! Each edge adds, row by row, the signed area between itself and the right border; a running sum
//! along the row then yields the covered share. Curves are polygons with many corners. Contours of
//! opposite sense cut holes.

/// A buffer in which one polygon at a time is measured.
#[derive(Debug)]
pub struct Coverage {
    width: usize,
    height: usize,
    /// One row has a cell more than it has pixels, for what lies beyond the right border.
    cells: Vec<f32>,
}

impl Coverage {
    /// For images of this size, px.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, cells: vec![0.0; (width + 2) * height] }
    }

    /// Calls `paint(x, y, share)` for each pixel with a covered share above zero, row by row.
    /// Corners are in pixels; the center of the top left pixel is (0, 0).
    pub fn fill(&mut self, contours: &[Vec<[f64; 2]>], mut paint: impl FnMut(usize, usize, f32)) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in contours.iter().flatten() {
            if !(corner[0].is_finite() && corner[1].is_finite()) {
                return;
            }
            for i in 0..2 {
                low[i] = low[i].min(corner[i] + 0.5);
                high[i] = high[i].max(corner[i] + 0.5);
            }
        }
        let (w, h) = (self.width as f64, self.height as f64);
        if !(low[0] < w && low[1] < h && high[0] > 0.0 && high[1] > 0.0) {
            return;
        }
        let rows = low[1].max(0.0) as usize..(high[1].min(h).ceil() as usize);
        let columns = low[0].max(0.0) as usize..(high[0].min(w).ceil() as usize);
        for contour in contours {
            for (i, a) in contour.iter().enumerate() {
                let b = contour[(i + 1) % contour.len()];
                self.edge([a[0] + 0.5, a[1] + 0.5], [b[0] + 0.5, b[1] + 0.5]);
            }
        }
        let stride = self.width + 2;
        for y in rows {
            let row = &mut self.cells[y * stride..(y + 1) * stride];
            let mut sum = 0.0_f32;
            for x in columns.clone() {
                sum += row[x];
                row[x] = 0.0;
                let share = sum.abs().min(1.0);
                if share > 1e-5 {
                    paint(x, y, share);
                }
            }
            for cell in &mut row[columns.end..(columns.end + 2).min(stride)] {
                *cell = 0.0;
            }
        }
    }

    /// One edge, cut at the left and right border so that what lies outside still counts for what
    /// is to its right.
    fn edge(&mut self, a: [f64; 2], b: [f64; 2]) {
        let w = self.width as f64;
        let dx = b[0] - a[0];
        let cut = |x: f64| if dx == 0.0 { 0.0 } else { ((x - a[0]) / dx).clamp(0.0, 1.0) };
        let (left, right) = (cut(0.0), cut(w));
        for ends in [0.0, left.min(right), left.max(right), 1.0].windows(2) {
            // No piece crosses a border, so that clamping its ends is exact.
            let at = |t: f64| [(a[0] + t * dx).clamp(0.0, w), a[1] + t * (b[1] - a[1])];
            self.edge_inside(at(ends[0]), at(ends[1]));
        }
    }

    fn edge_inside(&mut self, a: [f64; 2], b: [f64; 2]) {
        if a[1] == b[1] {
            return;
        }
        let (sign, top, bottom) = if a[1] < b[1] { (1.0, a, b) } else { (-1.0, b, a) };
        let slope = (bottom[0] - top[0]) / (bottom[1] - top[1]);
        let first = top[1].max(0.0);
        let last = bottom[1].min(self.height as f64);
        if first >= last {
            return;
        }
        let stride = self.width + 2;
        let x_at = |y: f64| {
            (top[0] + (y - top[1]) * slope).clamp(top[0].min(bottom[0]), top[0].max(bottom[0]))
        };
        for row in first as usize..last.ceil() as usize {
            let y0 = first.max(row as f64);
            let y1 = last.min((row + 1) as f64);
            let height = y1 - y0;
            if height <= 0.0 {
                continue;
            }
            let d = sign * height;
            let (xa, xb) = (x_at(y0), x_at(y1));
            let (x0, x1) = if xa < xb { (xa, xb) } else { (xb, xa) };
            let left = x0.floor();
            let i = left as usize;
            let cells = &mut self.cells[row * stride..(row + 1) * stride];
            if x1 <= left + 1.0 {
                // Within one pixel: a trapezoid.
                let right_of_edge = 1.0 - (0.5 * (x0 + x1) - left);
                cells[i] += (d * right_of_edge) as f32;
                cells[i + 1] += (d * (1.0 - right_of_edge)) as f32;
            } else {
                // Across several: a triangle, slabs, a triangle.
                let per_pixel = 1.0 / (x1 - x0);
                let in_first = left + 1.0 - x0;
                let area_first = 0.5 * per_pixel * in_first * in_first;
                cells[i] += (d * area_first) as f32;
                let right = x1.ceil();
                let n = (right - left) as usize;
                let in_last = x1 - (right - 1.0);
                let area_last = 1.0 - 0.5 * per_pixel * in_last * in_last;
                // Share of the pixel i + k that lies to the right of the edge's part above.
                let mut before = area_first;
                for k in 1..n {
                    let share = if k + 1 == n {
                        area_last
                    } else {
                        per_pixel * (in_first + k as f64 - 0.5)
                    };
                    cells[i + k] += (d * (share - before)) as f32;
                    before = share;
                }
                cells[i + n] += (d * (1.0 - before)) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Area of the polygon inside of a unit square by Sutherland and Hodgman's clipping.
    fn clipped_area(polygon: &[[f64; 2]], x: f64, y: f64) -> f64 {
        let mut p = polygon.to_vec();
        for (axis, bound, keep_above) in
            [(0, x - 0.5, true), (0, x + 0.5, false), (1, y - 0.5, true), (1, y + 0.5, false)]
        {
            let inside =
                |q: &[f64; 2]| if keep_above { q[axis] >= bound } else { q[axis] <= bound };
            let mut out = Vec::new();
            for i in 0..p.len() {
                let (a, b) = (p[i], p[(i + 1) % p.len()]);
                if inside(&a) {
                    out.push(a);
                }
                if inside(&a) != inside(&b) {
                    let t = (bound - a[axis]) / (b[axis] - a[axis]);
                    out.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
                }
            }
            p = out;
        }
        let cross = |a: [f64; 2], b: [f64; 2]| a[0] * b[1] - a[1] * b[0];
        (0..p.len()).map(|i| cross(p[i], p[(i + 1) % p.len()])).sum::<f64>().abs() / 2.0
    }

    proptest! {
        #[test]
        fn each_pixel_s_share_is_the_clipped_area_also_at_the_borders(
            cx in -4.0..20.0f64,
            cy in -4.0..16.0f64,
            radius in 0.2..9.0f64,
            turn in 0.0..6.3f64,
            corners in 3usize..7,
        ) {
            let polygon: Vec<[f64; 2]> = (0..corners)
                .map(|i| {
                    let angle = turn + std::f64::consts::TAU * i as f64 / corners as f64;
                    [cx + radius * angle.cos(), cy + radius * angle.sin()]
                })
                .collect();
            let mut coverage = Coverage::new(16, 12);
            // Twice: the second time shows that nothing was left behind by the first.
            for _ in 0..2 {
                let mut shares = vec![0.0; 16 * 12];
                coverage.fill(std::slice::from_ref(&polygon), |x, y, share| {
                    shares[y * 16 + x] = share;
                });
                for y in 0..12 {
                    for x in 0..16 {
                        let truth = clipped_area(&polygon, x as f64, y as f64);
                        let share = f64::from(shares[y * 16 + x]);
                        prop_assert!((share - truth).abs() < 3e-5, "{x} {y}: {share} {truth}");
                    }
                }
            }
            prop_assert!(coverage.cells.iter().all(|c| *c == 0.0));
        }
    }

    #[test]
    fn a_contour_of_the_other_sense_is_a_hole() {
        let square = |s: f64| {
            vec![[5.0 - s, 5.0 - s], [5.0 + s, 5.0 - s], [5.0 + s, 5.0 + s], [5.0 - s, 5.0 + s]]
        };
        let mut hole = square(2.0);
        hole.reverse();
        let mut area = 0.0;
        Coverage::new(11, 11).fill(&[square(4.0), hole], |_, _, share| area += share);
        assert!((area - 48.0).abs() < 1e-4);
    }
}
