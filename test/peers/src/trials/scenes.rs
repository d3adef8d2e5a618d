//! The misleading scenes themselves.

use crate::{
    scene::{Floor, Light, Pinhole, Plate, Rng, Thing},
    stage::{MUTED, VIVID},
    trajectory,
};
use nalgebra::{Isometry3, Vector2};
use std::f64::consts::TAU;

const CAMERA: Pinhole = Pinhole::BENCH;
const GRAY: [f32; 3] = [92.0, 90.0, 88.0];
const SKIN: [f32; 3] = [196.0, 150.0, 124.0];

/// What is to be seen at one moment.
pub struct Moment {
    /// `camera_from_volant` through the exposure.
    pub poses: Vec<Isometry3<f64>>,
    /// Light and sensor.
    pub light: Light,
    /// Things below the platform.
    pub under: Vec<Thing>,
    /// Things before it.
    pub over: Vec<Thing>,
    /// How far the floor has moved in the frame, px.
    pub floor_shift: Vector2<f64>,
}

impl Moment {
    fn new(pose: Isometry3<f64>) -> Self {
        Self {
            poses: vec![pose],
            light: Light { blur: 0.6, shading: 0.1, ..Light::default() },
            under: Vec::new(),
            over: Vec::new(),
            floor_shift: Vector2::zeros(),
        }
    }
}

/// A scene: name, frames and truth.
pub struct Scene {
    pub name: &'static str,
    pub images: usize,
    /// Share of the whole markers that must be detected.
    pub wanted: f64,
    pub plate: Plate,
    pub floor: Floor,
    pub at: Box<dyn Fn(f64) -> Moment>,
}

fn things(count: usize, colors: &[[f32; 3]], size: (f64, f64), rng: &mut Rng) -> Vec<Thing> {
    (0..count)
        .map(|i| {
            let shade = rng.within(0.85, 1.1) as f32;
            let color = colors[i % colors.len()].map(|c| c * shade);
            let at = Vector2::new(rng.within(-60.0, 700.0), rng.within(-60.0, 540.0));
            let size = Vector2::new(rng.within(size.0, size.1), rng.within(size.0, size.1));
            Thing::rectangle(at, size, rng.within(0.0, TAU), color)
        })
        .collect()
}

fn grays(rng: &mut Rng) -> Vec<[f32; 3]> {
    (0..12)
        .map(|_| {
            let level = rng.within(60.0, 190.0) as f32;
            [0; 3].map(|_| level + rng.within(-20.0, 20.0) as f32)
        })
        .collect()
}

fn floor(strewn: &[Thing], rng: &mut Rng) -> Floor {
    let mut floor = Floor::new(CAMERA.width, CAMERA.height, 100, [150.0, 146.0, 138.0], rng);
    let dull = grays(rng);
    floor.strew(&things(25, &dull, (8.0, 70.0), rng));
    floor.strew(strewn);
    floor
}

fn gentle(t: f64) -> Isometry3<f64> {
    let at = CAMERA.center()
        + Vector2::new(80.0 * (TAU * 0.25 * t).sin(), 40.0 * (TAU * 0.19 * t).cos());
    trajectory::pose(&CAMERA, at, 1.5, 0.15 * (TAU * 0.4 * t).sin(), 0.7 * t, 0.3 + 0.2 * t)
}

/// A rectangle fixed to the platform's plane, in its coordinates, m.
fn on_platform(pose: &Isometry3<f64>, x: f64, y: f64, size: f64, color: [f32; 3]) -> Thing {
    let h = size / 2.0;
    let corners = [[x - h, y - h], [x + h, y - h], [x + h, y + h], [x - h, y + h]];
    Thing { outline: CAMERA.polygon(pose, &corners, 0.0), color }
}

fn pole(x: f64, width: f64, angle: f64, color: [f32; 3]) -> Thing {
    Thing::rectangle(Vector2::new(x, 240.0), Vector2::new(width, 1400.0), angle, color)
}

/// All of them, from a seed.
pub fn all(seed: u64) -> Vec<Scene> {
    let mut rng = Rng::new(seed ^ 0xabcd);
    let mut scenes = Vec::new();
    let mut scene =
        |name, images, wanted, colors, strewn: Vec<Thing>, at: Box<dyn Fn(f64) -> Moment>| {
            let mut own = rng.clone();
            rng.bits();
            let plate = Plate::markers(colors, &mut own);
            let floor = floor(&strewn, &mut own);
            scenes.push(Scene { name, images, wanted, plate, floor, at });
        };
    let mut lay = Rng::new(seed ^ 0x1111);

    scene(
        "nominal",
        150,
        0.999,
        VIVID,
        vec![],
        Box::new(|t| Moment::new(trajectory::standard(&CAMERA, t))),
    );

    scene(
        "gamma 2.2",
        90,
        0.999,
        VIVID.map(|c| c.map(|v| 255.0 * (v / 255.0).powf(2.2))),
        vec![],
        {
            Box::new(|t| {
                let mut m = Moment::new(gentle(t));
                m.light.gamma = 2.2;
                m
            })
        },
    );

    scene(
        "muted paper, light ±30 %",
        150,
        0.99,
        MUTED,
        things(10, &MUTED, (15.0, 60.0), &mut lay),
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            m.light.gain = 1.0 + 0.3 * (TAU * 0.35 * t).sin();
            m.light.shading = 0.3;
            m.light.direction = t;
            m
        }),
    );

    scene(
        "clutter of marker colors",
        150,
        0.995,
        VIVID,
        things(24, &VIVID, (15.0, 70.0), &mut lay),
        Box::new(|t| Moment::new(gentle(t))),
    );

    scene("moving clutter", 150, 0.995, VIVID, things(8, &VIVID, (15.0, 60.0), &mut lay), {
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            for (i, color) in VIVID.iter().enumerate() {
                let i = i as f64;
                let at = Vector2::new(
                    320.0 + 330.0 * (TAU * (0.2 + 0.04 * i) * t + i).sin(),
                    240.0 + 220.0 * (TAU * (0.23 - 0.03 * i) * t + 2.0 * i).cos(),
                );
                m.under.push(Thing::rectangle(at, Vector2::new(30.0, 30.0), t + i, *color));
            }
            m
        })
    });

    scene("clutter beside the platform", 120, 0.995, VIVID, vec![], {
        Box::new(|t| {
            let pose = gentle(t);
            let mut m = Moment::new(pose);
            let beside = [
                (0.26, 0.0, 1),
                (-0.26, 0.1, 0),
                (0.05, 0.26, 3),
                (-0.1, -0.26, 2),
                (0.25, 0.24, 0),
                (-0.25, -0.24, 2),
            ];
            for (x, y, color) in beside {
                m.under.push(on_platform(&pose, x, y, 0.076, VIVID[color]));
            }
            m
        })
    });

    scene("light drop, white balance", 150, 0.995, VIVID, vec![], {
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            m.light.gain = if (1.0..3.0).contains(&t) { 0.45 } else { 1.0 };
            let drift = 0.15 * (TAU * 0.2 * t).sin();
            m.light.white = [1.0 + drift, 1.0, 1.0 - drift];
            m
        })
    });

    scene("full turn", 120, 0.999, VIVID, things(8, &VIVID, (15.0, 50.0), &mut lay), {
        Box::new(|t| {
            let tilt = 0.2 * (TAU * 0.5 * t).sin();
            Moment::new(trajectory::pose(&CAMERA, CAMERA.center(), 1.4, tilt, 0.4, TAU * t / 4.0))
        })
    });

    scene("fast motion, blurred", 120, 0.995, VIVID, things(8, &VIVID, (15.0, 50.0), &mut lay), {
        Box::new(|t| {
            let at = |t: f64| {
                let pixel = CAMERA.center()
                    + Vector2::new(110.0 * (TAU * t).sin(), 25.0 * (TAU * 1.3 * t).cos());
                trajectory::pose(&CAMERA, pixel, 1.5, 0.6 * (TAU * t).sin(), 1.2, 0.3)
            };
            let mut m = Moment::new(at(t));
            m.poses = (-2..=2).map(|i| at(t + 0.002 * f64::from(i))).collect();
            m
        })
    });

    scene("jerks", 90, 0.99, VIVID, things(8, &VIVID, (15.0, 50.0), &mut lay), {
        Box::new(|t| {
            // Every half second the platform is elsewhere, as after dropped images.
            let step = (t * 2.0).floor();
            let at = CAMERA.center()
                + Vector2::new(150.0 * (2.3 * step).sin(), 70.0 * (4.1 * step).cos());
            Moment::new(trajectory::pose(&CAMERA, at, 1.5, 0.1, step, 0.9 * step))
        })
    });

    scene("camera in motion", 120, 0.995, VIVID, things(20, &VIVID, (15.0, 50.0), &mut lay), {
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            m.floor_shift =
                Vector2::new(90.0 * (TAU * 0.5 * t).sin(), 60.0 * (TAU * 0.4 * t).sin());
            m
        })
    });

    scene("pole sweeps over", 180, 0.995, VIVID, vec![], {
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            m.over.push(pole(120.0 + 70.0 * t, 44.0, 0.25, GRAY));
            m
        })
    });

    scene("pole of a marker's color", 180, 0.995, VIVID, vec![], {
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            m.over.push(pole(120.0 + 70.0 * t, 18.0, 0.25, [180.0, 32.0, 40.0]));
            m.over.push(pole(520.0 - 60.0 * t, 18.0, -0.35, [34.0, 70.0, 185.0]));
            m
        })
    });

    scene("hand covers and stays", 180, 0.995, VIVID, vec![], {
        Box::new(|t| {
            let mut m = Moment::new(gentle(t));
            let reach = 170.0 + 110.0 * (TAU * 0.33 * t).sin();
            m.over.push(Thing::rectangle(
                Vector2::new(reach, 200.0),
                Vector2::new(200.0, 70.0),
                0.2,
                SKIN,
            ));
            m
        })
    });

    let back = |t: f64| (0.8..1.8).contains(&t) || (2.8..4.5).contains(&t);
    let tarp =
        || Thing::rectangle(Vector2::new(320.0, 240.0), Vector2::new(500.0, 440.0), 0.0, GRAY);
    scene("all gone and back", 180, 0.995, VIVID, vec![], {
        Box::new(move |t| {
            let mut m = Moment::new(gentle(1.7 * t));
            m.over.extend(back(t).then(tarp));
            m
        })
    });
    scene(
        "all gone amid clutter",
        180,
        0.995,
        VIVID,
        things(24, &VIVID, (15.0, 60.0), &mut lay),
        {
            Box::new(move |t| {
                let pose = gentle(1.7 * t);
                let mut m = Moment::new(pose);
                if back(t) {
                    // Only the platform is hidden: the clutter stays in sight.
                    m.over.push(Thing {
                        outline: on_platform(&pose, 0.0, 0.0, 0.46, GRAY).outline,
                        color: GRAY,
                    });
                }
                m
            })
        },
    );

    scene("leaves the frame", 150, 0.99, VIVID, vec![], {
        Box::new(|t| {
            let at = CAMERA.center() + Vector2::new(330.0 * (TAU * 0.2 * t).sin(), 30.0);
            Moment::new(trajectory::pose(&CAMERA, at, 1.5, 0.1, 0.5, 0.3))
        })
    });

    scene(
        "no platform, only clutter",
        90,
        0.0,
        VIVID,
        things(32, &VIVID, (15.0, 60.0), &mut lay),
        {
            Box::new(|_| {
                // Far outside of the frame.
                Moment::new(trajectory::pose(
                    &CAMERA,
                    Vector2::new(-2000.0, 240.0),
                    1.5,
                    0.0,
                    0.0,
                    0.0,
                ))
            })
        },
    );
    scenes
}
