//! The bench's standard images: one pose, three carriers of one footprint, the same light, floor
//! and noise.

use crate::{
    boards,
    methods::{Carrier, sift, tag_frame},
    scene::{Canvas, Floor, Frame, Light, Pinhole, Plate, Rng, Thing},
};
use anyhow::Result;
use nalgebra::{Isometry3, Vector2};
use std::f64::consts::TAU;

/// Edge of what the plates carry, m.
pub const FOOTPRINT: f64 = 0.376;

/// Paper as bright as it is sold: red, green, blue, yellow as the sensor sees them.
pub const VIVID: [[f32; 3]; 4] =
    [[205.0, 30.0, 35.0], [30.0, 180.0, 60.0], [30.0, 65.0, 200.0], [215.0, 200.0, 30.0]];

/// Plates, floor and canvas.
pub struct Stage {
    pub camera: Pinhole,
    canvas: Canvas,
    floor: Floor,
    plates: [Plate; 4],
    seed: u64,
}

impl Stage {
    /// With clutter of other colors on the floor.
    pub fn new(camera: Pinhole, seed: u64) -> Result<Self> {
        let mut rng = Rng::new(seed);
        let mut floor = Floor::new(camera.width, camera.height, 4, [150.0, 146.0, 138.0], &mut rng);
        let things: Vec<Thing> = (0..30)
            .map(|_| {
                let gray = rng.within(50.0, 190.0) as f32;
                let tint = [0; 3].map(|_| rng.within(-28.0, 28.0) as f32);
                Thing::rectangle(
                    Vector2::new(
                        rng.within(0.0, camera.width as f64),
                        rng.within(0.0, camera.height as f64),
                    ),
                    Vector2::new(rng.within(8.0, 70.0), rng.within(8.0, 70.0)),
                    rng.within(0.0, TAU),
                    tint.map(|t| gray + t),
                )
            })
            .collect();
        floor.strew(&things);
        let plates = [
            Plate::markers(VIVID, &mut rng),
            Plate::cells(10, tag_frame()?, [225.0; 3]),
            Plate::cells(sift::CELLS, sift::texture(seed), [118.0, 116.0, 112.0]),
            Plate::cells(boards::CELLS, boards::board(), [225.0; 3]),
        ];
        Ok(Self { canvas: Canvas::new(camera.width, camera.height), camera, floor, plates, seed })
    }

    pub fn plate(&self, carrier: Carrier) -> &Plate {
        &self.plates[carrier as usize]
    }

    /// The frame `number` of a carrier at a pose: noise σ = 3, ±10 % of light over time and over
    /// the frame.
    pub fn shoot(&mut self, carrier: Carrier, pose: &Isometry3<f64>, number: usize) -> Frame {
        let phase = number as f64;
        let light = Light {
            gain: 1.0 + 0.1 * (0.061 * phase).sin(),
            shading: 0.1,
            direction: 0.043 * phase,
        };
        self.floor.copy_to(&mut self.canvas);
        self.plates[carrier as usize].draw(&mut self.canvas, &self.camera, pose);
        let mut rng = Rng::new(
            self.seed ^ (number as u64 * 3 + carrier as u64 + 1).wrapping_mul(0x2545_f491),
        );
        self.canvas.expose(&light, &mut rng)
    }

    /// Where the markers, or the corners of the tag's black square, truly are.
    pub fn truth(&self, carrier: Carrier, pose: &Isometry3<f64>) -> Vec<Vector2<f64>> {
        match carrier {
            Carrier::Markers => self.plates[0].truth(&self.camera, pose).to_vec(),
            Carrier::Tag => {
                let h = 0.4 * FOOTPRINT;
                self.camera.polygon(pose, &[[-h, h], [h, h], [h, -h], [-h, -h]], 0.0)
            }
            Carrier::Texture | Carrier::Board => Vec::new(),
        }
    }
}
