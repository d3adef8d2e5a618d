//! `volant calibrate imu`: noise densities from a bag at rest.

use super::Output;
use crate::terminal;
use anyhow::{Context, Result, bail};
use bag::recording::read_messages;
use node_kit::{convert, outln};
use rig_calibration::allan::{ImuNoise, Sensor, imu_noise};
use rig_model::{ImuSample, topics::absolute};
use std::path::{Path, PathBuf};
use volant::{
    parameter_update::{Setting, number},
    replay::summarize,
    report::{Axis, Color, Panel, Series, Shape, Sheet, colors, panels},
};
use volant_msgs::{Message, sensor_msgs::msg::Imu};

#[derive(clap::Args)]
pub struct Arguments {
    /// Bag with volant/imu/data of the IMU at rest: a minute for the noise densities, hours for
    /// bias instability and random walk
    pub bag: PathBuf,
    /// Rig file to update
    #[arg(long, value_name = "FILE")]
    pub rig: PathBuf,
    /// IMU topic [default: volant/imu/data, or the only one]
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Figure to write: Allan deviation over averaging time
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    #[command(flatten)]
    pub output: Output,
}

/// Runs the command; returns what it found.
pub fn run(arguments: &Arguments) -> Result<ImuNoise> {
    super::read_rig(&arguments.rig)?;
    let inputs: [&Path; 2] = [&arguments.rig, &arguments.bag];
    arguments.output.check(arguments.plot.as_deref(), &inputs)?;
    let mut losses = vec![];
    let noise =
        read(&arguments.bag, arguments.topic.as_deref(), &mut losses).and_then(|mut samples| {
            samples.sort_by_key(|s| s.stamp);
            imu_noise(&samples).with_context(|| arguments.bag.display().to_string())
        });
    let noise = terminal::with_losses(noise, &losses)?;
    print(&noise)?;
    if let Some(plot) = &arguments.plot {
        node_kit::files::write(plot, figure(&noise)?.as_bytes(), arguments.output.overwrite)?;
    }
    let settings = Sensor::ALL.map(|sensor| {
        Setting::rig(format!("imu.{sensor}_noise_density"), number(noise.density(sensor), 3))
    });
    arguments.output.update(&arguments.rig, &settings, "")?;
    Ok(noise)
}

/// Reads the finite IMU samples of a bag; what it lost, and the number of the others, is appended
/// to `losses`.
///
/// # Errors
/// No IMU topic, or several without the rig's; an unreadable bag.
pub fn read(path: &Path, topic: Option<&str>, losses: &mut Vec<String>) -> Result<Vec<ImuSample>> {
    let shown = path.display();
    let summary = summarize(path, losses)?;
    let known = summary.topics_of(Imu::TYPE_NAME);
    let name = match (topic, known.as_slice()) {
        (Some(topic), _) if known.contains(&topic) => topic,
        (_, []) => bail!("{shown}: no IMU samples; record volant/imu/data"),
        (Some(topic), _) => {
            bail!("{shown}: no IMU samples on {topic}, but on {}", known.join(", "))
        }
        (None, [name]) => name,
        (None, _) if known.contains(&absolute::IMU) => absolute::IMU,
        (None, _) => bail!("{shown}: IMU samples on {}; name one with --topic", known.join(", ")),
    };
    let mut samples = read_messages(path, name, losses, |_, m: Imu| convert::imu_sample(&m))?;
    let all = samples.len();
    samples.retain(|s| s.angular_velocity.iter().chain(&s.specific_force).all(|x| x.is_finite()));
    let lost = all - samples.len();
    if lost > 0 {
        losses.push(format!(
            "{shown}: {lost} of {all} IMU samples on {name} are ignored: they are not finite (NaN \
             or infinite); check the IMU's driver"
        ));
    }
    Ok(samples)
}

fn print(noise: &ImuNoise) -> Result<()> {
    outln!("{:.1} s at {:.2} Hz", noise.seconds, noise.rate)?;
    let head = ["noise density", "+-", "bias instability", "random walk"];
    outln!("{:<18}{:>14}{:>8}{:>26}{:>14}", "", head[0], head[1], head[2], head[3])?;
    for sensor in Sensor::ALL {
        for (axis, name) in noise.sensors[sensor as usize].iter().zip(["x", "y", "z"]) {
            let instability = axis
                .instability
                .map_or("record longer".into(), |(b, tau)| format!("{b:.3e} (at {tau:.0} s)"));
            let walk = axis.walk.map_or("record longer".into(), |k| format!("{k:.3e}"));
            outln!(
                "{:<18}{:>14.4e}{:>6.1} %{instability:>26}{walk:>14}",
                format!("{sensor} {name}"),
                axis.density,
                100.0 * axis.uncertainty
            )?;
        }
        let unit = sensor.unit();
        outln!(
            "{:<18}{:>14.4e}  (root mean square; {unit}/sqrt(Hz), {unit}, {unit}*sqrt(Hz))",
            format!("{sensor}"),
            noise.density(sensor)
        )?;
    }
    Ok(())
}

/// Draws the Allan deviations of both sensors with the lines of their white noise.
fn figure(noise: &ImuNoise) -> Result<String> {
    let axes: [(&str, Color); 3] =
        [("x", colors::FUSED), ("y", colors::CAMERA), ("z", colors::INERTIAL)];
    let all = Sensor::ALL.map(|sensor| {
        let curves = &noise.sensors[sensor as usize];
        let points = || curves.iter().flat_map(|a| &a.curve);
        let least = points().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let most = points().map(|p| p.1).fold(0.0, f64::max);
        let span = [1.0 / noise.rate, points().map(|p| p.0).fold(0.0, f64::max)];
        let mut series: Vec<Series> = axes
            .iter()
            .zip(curves)
            .map(|((name, color), axis)| {
                Series::new(*name, *color, Shape::Line(2), axis.curve.clone())
            })
            .collect();
        let white = |tau: f64| (tau, noise.density(sensor) / tau.sqrt());
        let line = span.map(white);
        let name = "white noise as written to the rig file";
        series.push(Series::new(name, colors::SOFT, Shape::Line(1), line));
        Panel {
            title: sensor.to_string(),
            x: Axis::new("averaging time [s]", span, true),
            y: Axis::new(
                format!("Allan deviation [{}]", sensor.unit()),
                [0.8 * least, 1.25 * most],
                true,
            ),
            series,
        }
    });
    let sheet = Sheet { title: "Noise of the IMU at rest", size: (1120, 520), grid: (1, 2) };
    Ok(panels(sheet, &all)?)
}
