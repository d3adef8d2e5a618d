//! Painting of projected polygons, with light and shadows.

use super::*;

impl Renderer {
    pub(super) fn paint(
        &mut self,
        canvas: &mut [Colour],
        drawn: &Drawn,
        at: &Instant,
        seconds: f64,
    ) {
        let width = self.camera.size().0 as usize;
        if drawn.grain == 0.0 && self.scene.shadows.is_empty() {
            self.coverage.fill(&drawn.contours, |x, y, share| {
                blend(&mut canvas[y * width + x], drawn.colour, share);
            });
            return;
        }
        // The grain lies on the plate, so each pixel is led back to its place there.
        let camera_from_volant =
            (at.world_from_climber * self.climber_from_camera).inverse() * at.world_from_volant;
        let volant_from_camera = camera_from_volant.inverse();
        let r = volant_from_camera.rotation.to_rotation_matrix().matrix().cast::<f32>();
        let eye = volant_from_camera.translation.vector.cast::<f32>();
        let height = drawn.height as f32;
        let (rays, grain, shadows) = (&self.rays, &self.grain, &self.scene.shadows);
        let focal = self.camera.focal_lengths().x as f32;
        let world_from_volant = at.world_from_volant.cast::<f32>();
        let platform = world_from_volant.translation.vector.xy();
        self.coverage.fill(&drawn.contours, |x, y, share| {
            let at = y * width + x;
            let ray = rays[at];
            let direction = |i: usize| r[(i, 0)] * ray[0] + r[(i, 1)] * ray[1] + r[(i, 2)];
            let s = (height - eye.z) / direction(2);
            let (u, v) = (eye.x + s * direction(0), eye.y + s * direction(1));
            let noise = 1.0
                + drawn.grain
                    * (0.6 * grain.at(u * 230.0, v * 230.0) + 0.4 * grain.at(u * 31.0, v * 31.0));
            let shade = if shadows.is_empty() {
                [1.0; 3]
            } else {
                let place = (world_from_volant * Point3::new(u, v, height)).coords.xy();
                Shadow::light_of_all(shadows, place, platform, seconds, s.abs() / focal)
            };
            let colour = std::array::from_fn(|i| drawn.colour[i] * noise * shade[i]);
            blend(&mut canvas[at], colour, share);
        });
    }
}
