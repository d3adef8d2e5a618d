//! What the platform carries: four markers, a tag, or a texture, all of the same footprint.

use super::{
    canvas::Canvas,
    geometry::{Pinhole, polygon_centroid},
    rng::Rng,
};
use nalgebra::{Isometry3, Point3, Vector2};
use rig_model::{MarkerLayout, PerColor};

#[derive(Clone, Debug)]
pub enum PlateKind {
    /// Four squares: their colors, and the yaw of each in its plane, rad.
    Markers {
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
    pub color: [f32; 3],
    pub kind: PlateKind,
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

    pub fn draw(&self, canvas: &mut Canvas, camera: &Pinhole, pose: &Isometry3<f64>) {
        let half = self.edge / 2.0;
        let rim = [[-half, -half], [half, -half], [half, half], [-half, half]];
        canvas.add(&camera.polygon(pose, &rim, 0.0), self.color);
        canvas.flatten();
        match &self.kind {
            PlateKind::Markers { layout, colors, .. } => {
                for (color, paint) in colors.iter() {
                    let square = self.square(color.index());
                    canvas.add(&camera.polygon(pose, &square, layout.centers[color].z), *paint);
                }
                canvas.flatten();
            }
            PlateKind::Cells { side, gray, footprint } => {
                let cell = footprint / *side as f64;
                for (index, &value) in gray.iter().enumerate() {
                    let x = -footprint / 2.0 + (index % side) as f64 * cell;
                    let y = footprint / 2.0 - (index / side) as f64 * cell;
                    let corners = [[x, y], [x + cell, y], [x + cell, y - cell], [x, y - cell]];
                    canvas.add(&camera.polygon(pose, &corners, 0.0), [f32::from(value); 3]);
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

    /// Area centroid of each marker's image, px.
    pub fn truth(&self, camera: &Pinhole, pose: &Isometry3<f64>) -> [Vector2<f64>; 4] {
        let PlateKind::Markers { layout, .. } = &self.kind else {
            return [Vector2::zeros(); 4];
        };
        [0, 1, 2, 3].map(|i| {
            polygon_centroid(&camera.polygon(pose, &self.square(i), layout.centers.0[i].z)).1
        })
    }
}
