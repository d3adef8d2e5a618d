//! Writes images of the simulated rig to view: `cargo run --release -p rig_simulator
//! --example frame -- DIR SEED`.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use rig_model::{CameraModel, Distortion, MarkerColor, Rig};
use rig_simulator::{Covers, Exposure, Instant, RIG_YAML, Renderer, SceneConfig};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = std::path::PathBuf::from(arguments.next().unwrap_or_else(|| ".".into()));
    let seed = arguments.next().and_then(|s| s.parse().ok()).unwrap_or(1);
    let rig = Rig::from_yaml(RIG_YAML)?;
    let lens = Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]);
    for clutter in [false, true] {
        let camera = CameraModel::new(640, 480, [590.0, 588.0, 319.3, 235.2], lens)?;
        let mut renderer =
            Renderer::new(camera, &rig, SceneConfig { seed, clutter, ..SceneConfig::default() });
        let mut covers = Covers::default();
        if clutter {
            covers[MarkerColor::Blue] = 1.0;
        }
        let instant = Instant {
            world_from_climber: Isometry3::from_parts(
                Translation3::new(0.1, -0.2, 2.8),
                UnitQuaternion::identity(),
            ),
            world_from_volant: Isometry3::from_parts(
                Translation3::new(0.2, -0.1, 1.4),
                UnitQuaternion::from_euler_angles(0.2, -0.15, 0.3),
            ),
        };
        let image = renderer.render(&Exposure {
            instants: vec![instant; 4],
            covers,
            seconds: 0.3,
            noise: Some(1),
        });
        std::fs::write(folder.join(format!("frame_{seed}_{clutter}.jpg")), image.to_jpeg(90)?)?;
        #[allow(clippy::disallowed_methods)] // a measurement
        let start = std::time::Instant::now();
        for i in 0..30 {
            let _ = renderer.render(&Exposure {
                instants: vec![instant; 4],
                covers,
                seconds: 0.3,
                noise: Some(i),
            });
        }
        let rendering = start.elapsed();
        for _ in 0..30 {
            let _ = image.to_jpeg(90)?;
        }
        eprintln!("{:?} an image, {:?} a JPEG", rendering / 30, (start.elapsed() - rendering) / 30);
    }
    Ok(())
}
