//! Projection of the rig: platform, markers, covers and rope as polygons of the image.

use super::*;

impl Renderer {
    pub(super) fn project_rig(&self, at: &Instant, covers: &Covers) -> Vec<Drawn> {
        let world_from_camera = at.world_from_climber * self.climber_from_camera;
        let camera_from_volant = world_from_camera.inverse() * at.world_from_volant;
        let place = at.world_from_volant.translation.vector.cast::<f32>();
        // Brighter where the plate is turned towards the lamps.
        let lamp =
            Vector3::new(f64::from(self.light[0]), f64::from(self.light[1]), 3.0).normalize();
        let facing = (at.world_from_volant.rotation * Vector3::z()).dot(&lamp) / lamp.z;
        let light = self.light_at(place.x, place.y) * (0.45 + 0.55 * facing.clamp(0.2, 1.6)) as f32;
        let mut drawn: Vec<Drawn> = self
            .platform
            .pieces
            .iter()
            .filter_map(|piece| self.project_piece(piece, &camera_from_volant, light))
            .collect();
        for (color, amount) in covers.iter().filter(|(_, amount)| **amount > 0.0) {
            drawn.extend(self.project_piece(
                &self.plank(color, *amount),
                &camera_from_volant,
                light,
            ));
        }
        drawn.extend(self.project_rope(at, &world_from_camera, &camera_from_volant, light));
        drawn
    }

    pub(super) fn project_piece(
        &self,
        piece: &Piece,
        camera_from_volant: &Isometry3<f64>,
        light: f32,
    ) -> Option<Drawn> {
        let project =
            |p: &Point3<f64>| self.camera.project(&(camera_from_volant * p)).map(|p| [p.x, p.y]);
        let contours = piece
            .contours
            .iter()
            .map(|contour| contour.iter().map(project).collect::<Option<Vec<_>>>())
            .collect::<Option<Vec<_>>>()?;
        Some(Drawn {
            contours,
            colour: piece.colour.map(|v| v * light),
            grain: piece.grain,
            height: piece.contours.first()?.first()?.z,
        })
    }

    /// A plank above the marker, pushed in from outside.
    pub(super) fn plank(&self, color: MarkerColor, amount: f64) -> Piece {
        let center = self.layout.centers[color];
        let outward = Vector2::new(center.x, center.y).try_normalize(1e-6).unwrap_or(Vector2::x());
        let (half_width, half_length) = (0.85 * self.layout.side, 0.25);
        // Fully in, its end reaches beyond the square's inner corner.
        let along = half_length - 0.85 * self.layout.side
            + (1.0 - amount.clamp(0.0, 1.0)) * 2.4 * self.layout.side;
        let middle = Vector2::new(center.x, center.y) + outward * along;
        let flat =
            rectangle([middle.x, middle.y], outward.y.atan2(outward.x), half_length, half_width);
        let contour = flat.iter().map(|p| Point3::new(p[0], p[1], center.z + 0.02)).collect();
        Piece { contours: vec![contour], colour: [98.0, 84.0, 70.0], grain: 0.06 }
    }

    /// The rope as a band of its apparent width at each point.
    pub(super) fn project_rope(
        &self,
        at: &Instant,
        world_from_camera: &Isometry3<f64>,
        camera_from_volant: &Isometry3<f64>,
        light: f32,
    ) -> Option<Drawn> {
        let lower = camera_from_volant * self.platform.hook;
        let upper = world_from_camera.inverse() * (at.world_from_climber * self.scene.hoist);
        let radius = 0.005 * self.camera.focal_lengths().x;
        let mut line: Vec<(Vector2<f64>, f64)> = Vec::new();
        for step in 0..60 {
            let t = f64::from(step) / 60.0;
            let p = lower + (upper - lower) * t;
            if p.z < 0.1 {
                break;
            }
            let Some(pixel) = self.camera.project(&p) else { break };
            line.push((pixel, radius / p.z));
        }
        let end = line.get(1)?.0;
        let across = |i: usize| {
            let (a, b) = if i == 0 { (line[0].0, end) } else { (line[i - 1].0, line[i].0) };
            Vector2::new(-(b - a).y, (b - a).x).try_normalize(1e-9).unwrap_or(Vector2::x())
                * line[i].1
        };
        let side = |i: usize, sign: f64| {
            let p = line[i].0 + across(i) * sign;
            [p.x, p.y]
        };
        let contour = (0..line.len())
            .map(|i| side(i, 1.0))
            .chain((0..line.len()).rev().map(|i| side(i, -1.0)))
            .collect();
        Some(Drawn {
            contours: vec![contour],
            colour: [88.0 * light; 3],
            grain: 0.0,
            height: self.platform.hook.z,
        })
    }
}
