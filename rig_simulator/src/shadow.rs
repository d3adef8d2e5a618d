//! Shadows with straight edges: of a wall or a curtain, and of the rope.

use nalgebra::Vector2;

/// A strip of shadow on floor and platform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shadow {
    /// Share of the light that remains, r, g, b; the sky's light in a shadow is bluer than the
    /// lamp's.
    pub light: [f32; 3],
    /// Direction across the strip, rad from the world's x axis.
    pub direction: f32,
    /// Place of the strip's middle along that direction at time 0, m.
    pub offset: f32,
    /// Speed along that direction, m/s.
    pub speed: f32,
    /// Width of the strip, m; infinite widths cover the half-plane below `offset`.
    pub width: f32,
    /// Width of the penumbra, m.
    pub penumbra: f32,
    /// Whether the strip moves with the platform, like the rope's shadow, or lies on the floor's
    /// frame.
    pub follows_platform: bool,
}

impl Shadow {
    /// A hard-edged shadow of a wall that leaves this share of the light and sweeps over the scene.
    pub fn half_plane(light: f32, direction: f32, offset: f32, speed: f32) -> Self {
        Self {
            light: [light, light * 1.03, light * 1.1],
            direction,
            offset,
            speed,
            width: f32::INFINITY,
            penumbra: 0.002,
            follows_platform: false,
        }
    }

    /// The shadow of a rope of 10 mm, beside the platform's middle by `offset` (m).
    pub fn rope(light: f32, direction: f32, offset: f32, speed: f32) -> Self {
        Self {
            width: 0.01,
            penumbra: 0.004,
            follows_platform: true,
            ..Self::half_plane(light, direction, offset, speed)
        }
    }

    /// Share of a place's light that remains, r, g, b, averaged over a pixel of this size (m).
    ///
    /// `place`, `platform`: world frame, m; `seconds`: time of the scene.
    pub fn light_at(
        &self,
        place: Vector2<f32>,
        platform: Vector2<f32>,
        seconds: f64,
        pixel: f32,
    ) -> [f32; 3] {
        let origin = if self.follows_platform { platform } else { Vector2::zeros() };
        let (sin, cos) = self.direction.sin_cos();
        let across = (place - origin).dot(&Vector2::new(cos, sin))
            - self.offset
            - self.speed * seconds as f32;
        // Share of the interval [-∞, x] that the penumbra and the pixel see.
        let soft = self.penumbra.hypot(pixel);
        let below = |x: f32| (x / soft + 0.5).clamp(0.0, 1.0);
        let dark = if self.width.is_finite() {
            below(self.width / 2.0 - across) - below(-self.width / 2.0 - across)
        } else {
            below(-across)
        };
        self.light.map(|l| 1.0 - dark * (1.0 - l))
    }

    /// Share of a place's light that all shadows leave, r, g, b; as [`Shadow::light_at`].
    pub fn light_of_all(
        shadows: &[Self],
        place: Vector2<f32>,
        platform: Vector2<f32>,
        seconds: f64,
        pixel: f32,
    ) -> [f32; 3] {
        shadows.iter().fold([1.0; 3], |light, shadow| {
            let own = shadow.light_at(place, platform, seconds, pixel);
            std::array::from_fn(|i| light[i] * own[i])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shadow_has_its_light_inside_and_none_is_lost_outside() {
        let wall = Shadow::half_plane(0.4, 0.0, 0.1, 0.0);
        let at = |shadow: &Shadow, x: f32| {
            shadow.light_at(Vector2::new(x, 3.0), Vector2::new(0.5, 0.0), 0.0, 0.002)[0]
        };
        assert!((at(&wall, 0.0) - 0.4).abs() < 1e-6 && at(&wall, 0.2) == 1.0);
        assert!((at(&wall, 0.1) - 0.7).abs() < 1e-3);
        let rope = Shadow::rope(0.7, 0.0, 0.0, 0.0);
        assert!((at(&rope, 0.5) - 0.7).abs() < 1e-3);
        assert_eq!((at(&rope, 0.48), at(&rope, 0.52)), (1.0, 1.0));
    }
}
