//! Images of the climber's camera: floor, platform and rope through its lens, with motion blur and
//! noise.
//!
//! Input: poses of climber and platform at the instants of one exposure. Output: an RGB image. A
//! pixel at an edge is the mean over the pixel's area, so the centroid of a square in the image is
//! the one that [`rig_model::MarkerLayout::projected_centroid`] predicts; a test asserts it to 0.01
//! px.

use crate::{
    coverage::Coverage,
    floor::{Colour, Floor, Material, Noise, blend, circle, rectangle},
    platform::{Piece, Platform},
    random::Random,
    shadow::Shadow,
};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, PerColor, Rig};
use std::ops::Range;

/// What there is to see, apart from the rig itself.
#[derive(Clone, Debug)]
pub struct SceneConfig {
    /// Seed of everything that no other field determines.
    pub seed: u64,
    /// Puts distractors in the markers' colors on the floor, one of which moves.
    pub clutter: bool,
    /// Colors of the squares in full light; `None`: muted paper, by the seed.
    pub colours: Option<[Colour; 4]>,
    /// Standard deviation of the sensor's noise in the dark, gray values.
    pub read_noise: f64,
    /// Variance of the noise per gray value (photon noise).
    pub shot_noise: f64,
    /// Darkening of the image's corners (vignette).
    pub vignetting: f64,
    /// Where the rope comes from, climber frame, m.
    pub hoist: Point3<f64>,
    /// Shadows on floor and platform.
    pub shadows: Vec<Shadow>,
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            clutter: false,
            colours: None,
            read_noise: 1.2,
            shot_noise: 0.02,
            vignetting: 0.22,
            hoist: Point3::new(0.0, 0.16, 0.0),
            shadows: Vec::new(),
        }
    }
}

impl SceneConfig {
    /// Colors of the squares in full light.
    fn marker_colours(&self) -> [Colour; 4] {
        self.colours.unwrap_or_else(|| {
            let mut random = Random::fork(self.seed, "colours");
            [[196.0, 42.0, 58.0], [68.0, 160.0, 76.0], [48.0, 102.0, 184.0], [228.0, 206.0, 62.0]]
                .map(|c: Colour| c.map(|v| v + random.within(-8.0, 8.0) as f32))
        })
    }
}

/// Where things are at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    /// `world` from `climber`.
    pub world_from_climber: Isometry3<f64>,
    /// `world` from `volant`.
    pub world_from_volant: Isometry3<f64>,
}

/// How far a plank has been pushed over each marker: 0 not at all, 1 it covers all of it.
pub type Covers = PerColor<f64>;

/// One image to render.
#[derive(Clone, Debug)]
pub struct Exposure {
    /// Poses at instants spread evenly over the exposure: one without blur, five suffice for blur.
    pub instants: Vec<Instant>,
    /// Planks over the markers.
    pub covers: Covers,
    /// Time of the scene for what moves by itself, s.
    pub seconds: f64,
    /// Seed of the noise; `None`: an image without noise.
    pub noise: Option<u64>,
}

/// An image, `rgb8`, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbImage {
    /// px.
    pub width: u32,
    /// px.
    pub height: u32,
    /// Three bytes a pixel.
    pub data: Vec<u8>,
}

/// The camera in its world.
#[derive(Debug)]
pub struct Renderer {
    camera: CameraModel,
    climber_from_camera: Isometry3<f64>,
    scene: SceneConfig,
    layout: MarkerLayout,
    floor: Floor,
    platform: Platform,
    /// Undistorted ray (x/z, y/z) through each pixel.
    rays: Vec<[f32; 2]>,
    vignette: Vec<f32>,
    light: [f32; 2],
    grain: Noise,
    normals: Vec<f32>,
    coverage: Coverage,
    canvas: Vec<Colour>,
}

impl Renderer {
    /// A renderer for this lens, rig and scene.
    pub fn new(camera: CameraModel, rig: &Rig, scene: SceneConfig) -> Self {
        let (width, height) = camera.size();
        let marker_colours = scene.marker_colours();
        let mut random = Random::fork(scene.seed, "light");
        let materials = [Material::Carpet, Material::Wood, Material::Concrete];
        let material = materials[random.index(3)];
        let light = [random.within(-0.8, 0.8) as f32, random.within(-0.8, 0.8) as f32];
        let mut rays = Vec::with_capacity((width * height) as usize);
        let mut vignette = Vec::with_capacity(rays.capacity());
        let principal = camera.principal_point();
        let far = f64::from(width).hypot(f64::from(height)) / 2.0;
        for y in 0..height {
            for x in 0..width {
                let pixel = Vector2::new(f64::from(x), f64::from(y));
                // A corner beyond the lens model's reach is drawn as black.
                let ray = camera.undistort(&pixel).unwrap_or(Vector2::repeat(f64::NAN));
                rays.push([ray.x as f32, ray.y as f32]);
                let r = (pixel - principal).norm() / far;
                vignette.push((1.0 - scene.vignetting * r * r) as f32);
            }
        }
        let mut noise = Random::fork(scene.seed, "noise table");
        Self {
            climber_from_camera: rig.climber_from_camera,
            floor: Floor::new(scene.seed, material, scene.clutter.then_some(&marker_colours)),
            platform: Platform::new(&rig.markers, &marker_colours, scene.seed),
            layout: rig.markers.clone(),
            rays,
            vignette,
            light,
            grain: Noise::new(&mut random, 128),
            normals: (0..1 << 18).map(|_| noise.normal() as f32).collect(),
            coverage: Coverage::new(width as usize, height as usize),
            canvas: vec![[0.0; 3]; (width * height) as usize],
            camera,
            scene,
        }
    }

    /// The lens.
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// Renders an image. An exposure without instants is black.
    pub fn render(&mut self, exposure: &Exposure) -> RgbImage {
        let (width, height) = self.camera.size();
        let mut image = RgbImage { width, height, data: vec![0; (width * height * 3) as usize] };
        let Some(middle) = exposure.instants.get(exposure.instants.len() / 2) else { return image };
        let mut canvas = std::mem::take(&mut self.canvas);
        self.draw_floor(&mut canvas, middle, exposure.seconds);
        self.draw_rig(&mut canvas, exposure);
        self.expose(&canvas, exposure.noise, &mut image.data);
        self.canvas = canvas;
        image
    }

    /// Brightness of the light at a place above the floor.
    fn light_at(&self, x: f32, y: f32) -> f32 {
        let d2 = (x - self.light[0]).powi(2) + (y - self.light[1]).powi(2);
        0.74 + 0.34 / (1.0 + 0.45 * d2)
    }

    fn draw_floor(&mut self, canvas: &mut [Colour], at: &Instant, seconds: f64) {
        let world_from_camera = at.world_from_climber * self.climber_from_camera;
        let r = world_from_camera.rotation.to_rotation_matrix().matrix().cast::<f32>();
        let eye = world_from_camera.translation.vector.cast::<f32>();
        let platform = at.world_from_volant.translation.vector.cast::<f32>();
        let (focal, shadows) = (self.camera.focal_lengths().x as f32, &self.scene.shadows);
        for (value, ray) in canvas.iter_mut().zip(&self.rays) {
            let direction = |i: usize| r[(i, 0)] * ray[0] + r[(i, 1)] * ray[1] + r[(i, 2)];
            let down = direction(2);
            if down.is_nan() || down > -1e-3 {
                *value = [0.0; 3];
                continue;
            }
            let s = -eye.z / down;
            let (x, y) = (eye.x + s * direction(0), eye.y + s * direction(1));
            // The platform's soft shadow.
            let d2 = ((x - platform.x).powi(2) + (y - platform.y).powi(2)) / 0.16;
            let light = self.light_at(x, y) * (1.0 - 0.38 / (1.0 + d2 * d2));
            let place = Vector2::new(x, y);
            let pixel = s.abs() / focal;
            let shade = Shadow::light_of_all(shadows, place, platform.xy(), seconds, pixel);
            let floor = self.floor.at(x, y);
            *value = std::array::from_fn(|i| floor[i] * light * shade[i]);
        }
        if self.scene.clutter {
            self.draw_toy(canvas, &world_from_camera, seconds);
        }
    }

    /// A red toy that drives in a circle on the floor.
    fn draw_toy(
        &mut self,
        canvas: &mut [Colour],
        world_from_camera: &Isometry3<f64>,
        seconds: f64,
    ) {
        let angle = 0.8 * seconds;
        let center = [0.75 * angle.cos(), 0.75 * angle.sin()];
        let light = self.light_at(center[0] as f32, center[1] as f32);
        let camera_from_world = world_from_camera.inverse();
        let width = self.camera.size().0 as usize;
        let [red, _, blue, _] = self.scene.marker_colours();
        for (flat, colour) in
            [(rectangle(center, angle, 0.05, 0.075), red), (circle(center, 0.03, 24), blue)]
        {
            let contour = flat.iter().map(|p| Point3::new(p[0], p[1], 0.0)).collect();
            let piece = Piece { contours: vec![contour], colour, grain: 0.0 };
            let Some(drawn) = self.project_piece(&piece, &camera_from_world, light) else {
                continue;
            };
            self.coverage.fill(&drawn.contours, |x, y, share| {
                blend(&mut canvas[y * width + x], drawn.colour, share);
            });
        }
    }

    /// Platform, planks and rope at each instant of the exposure, and the mean of them.
    fn draw_rig(&mut self, canvas: &mut [Colour], exposure: &Exposure) {
        let width = self.camera.size().0 as usize;
        let drawings: Vec<Vec<Drawn>> = exposure
            .instants
            .iter()
            .map(|instant| self.project_rig(instant, &exposure.covers))
            .collect();
        let Some([columns, rows]) = self.region(drawings.iter().flatten()) else { return };
        let row = |y: usize| y * width + columns.start..y * width + columns.end;
        let rows = || rows.clone();
        let floor: Vec<Colour> = rows().flat_map(|y| canvas[row(y)].to_vec()).collect();
        let mut sum = vec![[0.0_f32; 3]; floor.len()];
        let weight = 1.0 / drawings.len() as f32;
        for (drawn, instant) in drawings.iter().zip(&exposure.instants) {
            for (y, line) in rows().zip(floor.chunks(columns.len())) {
                canvas[row(y)].copy_from_slice(line);
            }
            for piece in drawn {
                self.paint(canvas, piece, instant, exposure.seconds);
            }
            for (y, line) in rows().zip(sum.chunks_mut(columns.len())) {
                for (total, value) in line.iter_mut().zip(&canvas[row(y)]) {
                    for (t, v) in total.iter_mut().zip(value) {
                        *t += weight * v;
                    }
                }
            }
        }
        for (y, line) in rows().zip(sum.chunks(columns.len())) {
            canvas[row(y)].copy_from_slice(line);
        }
    }

    /// Columns and rows of the image that are redrawn at each instant; `None` where there are none.
    fn region<'a>(&self, drawn: impl Iterator<Item = &'a Drawn>) -> Option<[Range<usize>; 2]> {
        let (width, height) = self.camera.size();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in drawn.flat_map(|d| d.contours.iter().flatten()) {
            for i in 0..2 {
                low[i] = low[i].min(corner[i]);
                high[i] = high[i].max(corner[i]);
            }
        }
        let span = |i: usize, size: u32| {
            let size = f64::from(size);
            (low[i] - 1.0).clamp(0.0, size) as usize..(high[i] + 2.0).clamp(0.0, size) as usize
        };
        let region = [span(0, width), span(1, height)];
        (low[0].is_finite() && region.iter().all(|r| !r.is_empty())).then_some(region)
    }

    /// Vignetting, noise, and eight bits.
    fn expose(&self, canvas: &[Colour], noise: Option<u64>, data: &mut [u8]) {
        let width = self.camera.size().0 as usize;
        let mask = self.normals.len() - 1;
        let (read, shot) = (self.scene.read_noise.powi(2) as f32, self.scene.shot_noise as f32);
        let mut random = noise.map(|seed| Random::fork(seed, "sensor"));
        for ((line, vignette), out) in
            canvas.chunks(width).zip(self.vignette.chunks(width)).zip(data.chunks_mut(3 * width))
        {
            let mut at = random.as_mut().map(|r| r.bits() as usize);
            for ((colour, v), bytes) in line.iter().zip(vignette).zip(out.chunks_exact_mut(3)) {
                for (value, byte) in colour.iter().zip(bytes) {
                    let mut value = value * v;
                    if let Some(at) = &mut at {
                        value += (read + shot * value).sqrt() * self.normals[*at & mask];
                        *at = at.wrapping_add(1);
                    }
                    // `as` rounds towards zero and clamps to 0 … 255.
                    *byte = (value + 0.5) as u8;
                }
            }
        }
    }
}

/// A piece in image coordinates.
#[derive(Clone, Debug)]
struct Drawn {
    contours: Vec<Vec<[f64; 2]>>,
    colour: Colour,
    grain: f32,
    /// z of its plane in the volant frame, m.
    height: f64,
}

impl RgbImage {
    /// Encodes as baseline JPEG of this quality (1 to 100), colors at half resolution as cameras do
    /// it.
    ///
    /// # Errors
    /// The encoder's error; sizes above 65535 px.
    pub fn to_jpeg(&self, quality: u8) -> Result<Vec<u8>, jpeg_encoder::EncodingError> {
        let mut bytes = Vec::with_capacity(self.data.len() / 8);
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, quality);
        encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_2_2);
        // The encoder's default takes one pixel of four, which moves every colored edge by half a
        // pixel.
        encoder.set_chroma_subsampling_method(jpeg_encoder::ChromaSubsamplingMethod::Average);
        encoder.encode(
            &self.data,
            self.width as u16,
            self.height as u16,
            jpeg_encoder::ColorType::Rgb,
        )?;
        Ok(bytes)
    }
}

mod paint;
mod projection;
#[cfg(test)]
pub(crate) mod tests;
