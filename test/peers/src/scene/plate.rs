//! What the platform carries: four markers, a tag, or a texture, all of the same footprint.

use super::{
    canvas::{Canvas, for_each_covered},
    floor::Thing,
    geometry::{Pinhole, clip_area, polygon_centroid},
    rng::Rng,
};
use nalgebra::{Isometry3, Point3, Vector2};
use rig_model::{MarkerLayout, PerColor};

/// What is on the plate.
#[derive(Clone, Debug)]
pub enum PlateKind {
    /// Four squares: their colors, and the yaw of each in its plane, rad.
    Markers {
        /// Where they are.
        layout: MarkerLayout,
        /// Red, green, blue, yellow as the sensor sees them.
        colors: PerColor<[f32; 3]>,
        /// rad.
        turns: [f64; 4],
    },
    /// `side`×`side` gray cells, from the top left as seen from above, in a square of `footprint`
    /// m.
    Cells {
        /// Cells along an edge.
        side: usize,
        /// Gray levels, row by row.
        gray: Vec<u8>,
        /// Edge of the whole, m.
        footprint: f64,
    },
}

/// The platform's upper side: a plate of one color with a pattern.
#[derive(Clone, Debug)]
pub struct Plate {
    /// Edge of the plate, m.
    pub edge: f64,
    /// Its color.
    pub color: [f32; 3],
    /// What is on it.
    pub kind: PlateKind,
}

/// Where a marker truly is in the frame.
#[derive(Clone, Copy, Debug)]
pub struct MarkerTruth {
    /// Area centroid of the whole square's image, px (the mean over the exposure).
    pub centroid: Vector2<f64>,
    /// Share that is in the frame and not covered.
    pub shown: f64,
}

impl Plate {
    /// Four 76 mm squares on a 0.30 m square, the bench's standard.
    pub fn markers(colors: [[f32; 3]; 4], rng: &mut Rng) -> Self {
        let at = |x, y| Point3::new(x, y, 0.0);
        let layout = MarkerLayout {
            side: 0.076,
            centers: PerColor([at(0.15, 0.15), at(-0.15, 0.15), at(-0.15, -0.15), at(0.15, -0.15)]),
        };
        let turns = [0; 4].map(|_| rng.within(-0.06, 0.06));
        Self {
            edge: 0.42,
            color: [118.0, 116.0, 112.0],
            kind: PlateKind::Markers { layout, colors: PerColor(colors), turns },
        }
    }

    /// Gray cells on the markers' footprint. A tag's plate is white, because ArUco drops a tag
    /// whose quiet zone ends in an edge near its own.
    pub fn cells(side: usize, gray: Vec<u8>, color: [f32; 3]) -> Self {
        Self { edge: 0.42, color, kind: PlateKind::Cells { side, gray, footprint: 0.376 } }
    }

    /// Draws the plate at each of the poses of an exposure.
    pub fn draw(&self, canvas: &mut Canvas, camera: &Pinhole, poses: &[Isometry3<f64>]) {
        let weight = 1.0 / poses.len() as f64;
        let half = self.edge / 2.0;
        let rim = [[-half, -half], [half, -half], [half, half], [-half, half]];
        for pose in poses {
            canvas.add(&camera.polygon(pose, &rim, 0.0), self.color, weight);
        }
        canvas.flatten();
        match &self.kind {
            PlateKind::Markers { layout, colors, .. } => {
                for (color, paint) in colors.iter() {
                    for pose in poses {
                        let z = layout.centers[color].z;
                        canvas.add(
                            &camera.polygon(pose, &self.square(color.index()), z),
                            *paint,
                            weight,
                        );
                    }
                }
                canvas.flatten();
            }
            PlateKind::Cells { side, gray, footprint } => {
                let cell = footprint / *side as f64;
                for (index, &value) in gray.iter().enumerate() {
                    let x = -footprint / 2.0 + (index % side) as f64 * cell;
                    let y = footprint / 2.0 - (index / side) as f64 * cell;
                    let corners = [[x, y], [x + cell, y], [x + cell, y - cell], [x, y - cell]];
                    for pose in poses {
                        canvas.add(
                            &camera.polygon(pose, &corners, 0.0),
                            [f32::from(value); 3],
                            weight,
                        );
                    }
                }
                canvas.flatten();
            }
        }
    }

    /// Corners of a marker in the plate's frame, m.
    fn square(&self, index: usize) -> [[f64; 2]; 4] {
        let PlateKind::Markers { layout, turns, .. } = &self.kind else { return [[0.0; 2]; 4] };
        let (center, half) = (layout.centers.0[index], layout.side / 2.0);
        let (sin, cos) = turns[index].sin_cos();
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            [center.x + half * (cos * x - sin * y), center.y + half * (sin * x + cos * y)]
        })
    }

    /// The truth of each marker under these covers.
    pub fn truth(
        &self,
        camera: &Pinhole,
        poses: &[Isometry3<f64>],
        covers: &[Thing],
    ) -> [MarkerTruth; 4] {
        let middle = &poses[poses.len() / 2];
        let PlateKind::Markers { layout, .. } = &self.kind else {
            return [MarkerTruth { centroid: Vector2::zeros(), shown: 0.0 }; 4];
        };
        [0, 1, 2, 3].map(|i| {
            let z = layout.centers.0[i].z;
            let images: Vec<_> =
                poses.iter().map(|p| camera.polygon(p, &self.square(i), z)).collect();
            let centroid = images.iter().map(|p| polygon_centroid(p).1).sum::<Vector2<f64>>()
                / poses.len() as f64;
            let image = camera.polygon(middle, &self.square(i), z);
            let area = polygon_centroid(&image).0.abs();
            let mut seen = 0.0;
            for_each_covered(&image, camera.width, camera.height, |index, share| {
                let (x, y) = ((index % camera.width) as f64, (index / camera.width) as f64);
                seen += share * (1.0 - cover_by(covers, x, y));
            });
            MarkerTruth { centroid, shown: seen / area }
        })
    }
}

/// Share of a pixel that things cover.
pub fn cover_by(covers: &[Thing], x: f64, y: f64) -> f64 {
    1.0 - covers.iter().map(|c| 1.0 - clip_area(&c.outline, x, y)).product::<f64>()
}
