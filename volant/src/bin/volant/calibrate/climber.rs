//! `volant calibrate climber`: the encoders' names, signs, scales, zeros and height from a jog.

use super::Output;
use crate::{settings::BagTopics, terminal};
use anyhow::{Context, Result, bail, ensure};
use bag::recording::read_messages;
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::{convert, outln};
use pose_fusion::FusionConfig;
use rig_calibration::climber::{AXES, ClimberCalibration, Jog, Value, calibrate_climber};
use rig_model::{Rig, topics};
use ros_parameters::{ParameterFile, ParameterMap, ParameterValue};
use std::path::{Path, PathBuf};
use volant::{
    calibration::read_markers,
    command_line::UsageError,
    parameter_update::{
        ENCODER_SCALE_SIGMA, LAYOUT_SIGMA, MOUNTING_SIGMA, Setting, full_name, list, number,
        of_fusion, sigma,
    },
    replay::{Cores, TopicNames, summarize},
};
use volant_msgs::{Message, sensor_msgs::msg::JointState};

/// The node whose parameters are found, in any namespace.
pub const NODE: &str = "/**/climber_driver";

#[derive(clap::Args)]
pub struct Arguments {
    /// Bag with climber/joint_states, images (or climber/markers) and camera_info: the platform
    /// rests on the floor in view of the camera, the climber starts turned to within 45 degrees of
    /// zero, and one axis after the other is jogged back and forth, as far as the platform stays in
    /// view (0.3 m or 20 degrees at least)
    #[arg(required_unless_present = "live")]
    pub bag: Option<PathBuf>,
    /// Record live topics instead of reading a bag
    #[arg(long, conflicts_with = "bag")]
    pub live: bool,
    /// Duration of the live recording, s (Ctrl-C ends it earlier)
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 60.0,
        value_parser = volant::command_line::number(0.1..=1e6)
    )]
    pub duration: f64,
    /// Rig file: marker layout and camera mounting. Its calibration.encoder_scale_sigma of
    /// pose_fusion is updated, where it has one
    #[arg(long, value_name = "FILE")]
    pub rig: PathBuf,
    /// Parameter file of climber_driver to update [default: the rig file]
    #[arg(long, value_name = "FILE")]
    pub params_file: Option<PathBuf>,
    /// Node whose parameters are updated; `/**/` stands for any namespace, with --namespace for
    /// that one
    #[arg(long, value_name = "NAME", default_value = NODE)]
    pub node: String,
    /// Where the platform's origin is in the world while it rests, m: gives the readings at the
    /// world's origin and the height. For an origin on the floor below the platform: 0,0,Z with the
    /// height Z of the platform's origin above the floor
    #[arg(long, value_name = "X,Y,Z", value_parser = position, allow_hyphen_values = true)]
    pub platform: Option<Vector3<f64>>,
    /// Also correct camera.position (x, y) and the tilt in camera.orientation of the rig file,
    /// where the jog shows them, and calibration.mounting_sigma of pose_fusion where the file has
    /// it
    #[arg(long)]
    pub camera: bool,
    #[command(flatten)]
    pub topics: BagTopics,
    #[command(flatten)]
    pub output: Output,
}

fn position(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, z]) if [x, y, z].iter().all(|n| n.is_finite()) => Ok(Vector3::new(*x, *y, *z)),
        _ => Err("write it as X,Y,Z in meters, such as 0,0,0.12".to_owned()),
    }
}

/// Error of a camera's principal point that the jog takes for a tilt, rad: half a pixel of 500.
const CENTER: f64 = 1e-3;

/// Runs the command; returns what it found.
pub fn run(arguments: &Arguments) -> Result<ClimberCalibration> {
    if arguments.params_file.is_some() && arguments.camera && arguments.output.out.is_some() {
        let text = "--camera changes the rig file and --params-file another one: leave --out out, \
                    which is one file";
        return Err(UsageError(text.to_owned()).into());
    }
    let rig = super::read_rig(&arguments.rig)?;
    let file = arguments.params_file.as_ref().unwrap_or(&arguments.rig);
    let shown = file.display();
    let inputs = [&arguments.rig, file].into_iter().chain(&arguments.bag);
    arguments.output.check(None, &inputs.map(PathBuf::as_path).collect::<Vec<_>>())?;
    let text =
        node_kit::files::read_text(file).with_context(|| format!("{shown}: not readable"))?;
    let namespace = &arguments.topics.namespace;
    let node = match (arguments.node.as_str(), namespace.trim_matches('/')) {
        (NODE, name) if !name.is_empty() => full_name(name, "climber_driver"),
        (node, _) => node.to_owned(),
    };
    // The update rejects an invalid file; one of comments only is a valid start.
    let present = ParameterFile::parse(&text).unwrap_or_default().for_node(&node);
    let found = match &arguments.bag {
        Some(bag) => from_bag(bag, arguments, &arguments.topics.names(), &rig, &present)?,
        None => live(arguments, &rig, &present)?,
    };
    print(&found, &present)?;
    let mut settings = settings(&found, &node);
    let of_rig = rig_settings(&found, arguments, &rig)?;
    if arguments.params_file.is_none() {
        settings.extend(of_rig.clone());
    }
    arguments.output.update(file, &settings, namespace)?;
    if arguments.params_file.is_some() && !of_rig.is_empty() {
        if arguments.output.out.is_none() {
            Output::default().update(&arguments.rig, &of_rig, namespace)?;
        } else {
            let names: Vec<_> = of_rig.iter().map(|s| format!("{} {}", s.name, s.value)).collect();
            let (names, rig) = (names.join(", "), arguments.rig.display());
            outln!("{rig}: unchanged, because of --out; enter {names}")?;
        }
    }
    Ok(found)
}

/// What the jog says about the rig and about the sigmas of the fusion node.
fn rig_settings(
    found: &ClimberCalibration,
    arguments: &Arguments,
    rig: &Rig,
) -> Result<Vec<Setting>> {
    let (file, namespace) = (&arguments.rig, &arguments.topics.namespace);
    let mut settings = if arguments.camera { camera_settings(found, rig) } else { vec![] };
    let turn = found.axes[2].as_ref().and_then(|turn| turn.zero);
    // The zero of the turn contains the camera's yaw.
    if let (true, Some([x, y]), Some(_)) = (arguments.camera, found.camera_tilt, turn) {
        let tilt = x.1.max(y.1).hypot(CENTER);
        settings.extend(sigma(file, namespace, MOUNTING_SIGMA, tilt, false)?);
    }
    if let [Some(x), Some(y), _] = &found.axes {
        let jog = [x, y].map(|axis| (axis.scale.1 / axis.scale.0).abs()).into_iter();
        // The jog measures in lengths of the layout.
        let layout = of_fusion(file, namespace, LAYOUT_SIGMA)?.map(|(_, known)| known);
        let layout = layout.unwrap_or(FusionConfig::default().tight.calibration.layout);
        let scale = jog.fold(0.0, f64::max).hypot(layout);
        settings.extend(sigma(file, namespace, ENCODER_SCALE_SIGMA, scale, false)?);
    }
    Ok(settings)
}

fn from_bag(
    path: &Path,
    arguments: &Arguments,
    names: &TopicNames,
    rig: &Rig,
    present: &ParameterMap,
) -> Result<ClimberCalibration> {
    let mut losses = vec![];
    let found = find(path, arguments.platform, names, rig, present, &mut losses);
    terminal::with_losses(found, &losses)
}

fn find(
    path: &Path,
    platform: Option<Vector3<f64>>,
    names: &TopicNames,
    rig: &Rig,
    present: &ParameterMap,
    losses: &mut Vec<String>,
) -> Result<ClimberCalibration> {
    let shown = path.display();
    let summary = summarize(path, losses)?;
    let topic = names.choose(&summary, &[(topics::JOINT_STATES, JointState::TYPE_NAME)]);
    let Some((_, topic)) = topic.with_context(|| shown.to_string())? else {
        let topic = names.resolve(topics::JOINT_STATES);
        bail!("{shown}: no sensor_msgs/JointState in it; record {topic}");
    };
    let joints =
        read_messages(path, &topic, losses, |_, m: JointState| convert::joint_reading(&m))?;
    let cores = Cores { names: names.clone(), ..Cores::of(rig) };
    let (camera, markers) = read_markers(path, &cores, losses)?;
    // Joints to prefer where two measure the same axis: those in use.
    let preferred = AXES.map(|axis| match present.get(&format!("joints.{axis}")) {
        Some(ParameterValue::String(name)) => name.as_str(),
        _ => axis,
    });
    let jog = Jog { camera: &camera, rig, markers: &markers, joints: &joints, preferred, platform };
    calibrate_climber(&jog).with_context(|| shown.to_string())
}

/// Records the jog. Markers of a running tracker are preferred to raw images, which are large.
fn live(arguments: &Arguments, rig: &Rig, present: &ParameterMap) -> Result<ClimberCalibration> {
    use rig_model::topics::absolute;
    let topics = [
        absolute::JOINT_STATES,
        absolute::CAMERA_INFO,
        absolute::MARKERS,
        absolute::COMPRESSED_IMAGE,
    ];
    let stop = node_kit::console::stop_flag()?;
    let topics = topics.map(str::to_owned).to_vec();
    let recorded = super::live::record(topics, arguments.duration, &stop)?;
    let missing = |topic: &str| recorded.unpublished.iter().any(|t| t == topic);
    for topic in [absolute::JOINT_STATES, absolute::CAMERA_INFO] {
        if missing(topic) {
            bail!("{topic}: no publisher; start the control stack and the camera's driver");
        }
    }
    if missing(absolute::MARKERS) && missing(absolute::COMPRESSED_IMAGE) {
        bail!(
            "neither {} nor {} has a publisher; start marker_tracker",
            absolute::MARKERS,
            absolute::COMPRESSED_IMAGE
        );
    }
    ensure!(recorded.messages > 0, "no message was recorded; jog the climber while it records");
    from_bag(recorded.path(), arguments, &TopicNames::default(), rig, present)
}

fn settings(found: &ClimberCalibration, node: &str) -> Vec<Setting> {
    let mut settings = vec![];
    let mut set = |name: String, value| {
        settings.push(Setting { node: node.to_owned(), name, value });
    };
    for (axis, name) in found.axes.iter().zip(AXES) {
        let Some(axis) = axis else { continue };
        set(format!("joints.{name}"), ParameterValue::String(axis.joint.clone()));
        set(format!("scale.{name}"), number(axis.scale.0, 7));
        if let Some(zero) = axis.zero {
            set(format!("zero.{name}"), number(zero.0, 7));
        }
    }
    if let Some(height) = found.height {
        set("height".to_owned(), number(height.0, 5));
    }
    settings
}

fn camera_settings(found: &ClimberCalibration, rig: &Rig) -> Vec<Setting> {
    let mut settings = vec![];
    if let Some([x, y]) = found.camera_offset {
        let position = rig.climber_from_camera.translation.vector + Vector3::new(x.0, y.0, 0.0);
        settings.push(Setting::rig("camera.position", list(position.as_slice())));
    }
    if let Some([x, y]) = found.camera_tilt {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(x.0, y.0, 0.0));
        let q = (tilt * rig.climber_from_camera.rotation).coords;
        settings.push(Setting::rig("camera.orientation", list(&[q.x, q.y, q.z, q.w])));
    }
    settings
}

/// Whether the climber has no such axis: its joint's name is empty.
pub fn is_absent(present: &ParameterMap, axis: &str) -> bool {
    let name = present.get(&format!("joints.{axis}"));
    name.is_some_and(|name| *name == ParameterValue::String(String::new()))
}

fn print(found: &ClimberCalibration, present: &ParameterMap) -> Result<()> {
    outln!("{} images, pixel residual {:.3} px RMS", found.images, found.pixel_rms)?;
    outln!("{:<16}{:>16}{:>16}{:>12}", "", "in the file", "found", "std dev")?;
    let row = |name: &str, value: Option<Value>, unit: &str, remedy: &str| {
        let before = present.get(name).map_or("-".into(), ToString::to_string);
        match value {
            Some((value, sigma)) => {
                let value = number(value, 7).to_string();
                outln!("{name:<16}{before:>16}{value:>16}{sigma:>12.2e}  {unit}")
            }
            None => outln!("{name:<16}{before:>16}  unobservable: survey it{remedy}"),
        }
    };
    for (axis, name) in found.axes.iter().zip(AXES) {
        let known = axis.as_ref();
        if known.is_none() && is_absent(present, name) {
            outln!("{:<16}{:>16}  the climber has no such axis", format!("joints.{name}"), "\"\"")?;
            continue;
        }
        let before = present.get(&format!("joints.{name}")).map_or("-".into(), ToString::to_string);
        let joint = known.map_or("unobservable: jog it", |a| a.joint.as_str());
        outln!("{:<16}{before:>16}{joint:>16}", format!("joints.{name}"))?;
        let unit = if name == "turn" { "rad" } else { "m" };
        let jog = ", or jog it";
        row(&format!("scale.{name}"), known.map(|a| a.scale), &format!("{unit} per unit"), jog)?;
        let survey =
            if name == "turn" { ", or jog a rail too" } else { ", or give --platform X,Y,Z" };
        row(&format!("zero.{name}"), known.and_then(|a| a.zero), "units of the reading", survey)?;
    }
    row("height", found.height, "m", ", or give --platform X,Y,Z")?;
    let shown = |what: &str, value: Option<[Value; 2]>, scale: f64, unit: &str, least: f64| {
        let Some([x, y]) = value else { return Ok(()) };
        if [x, y].iter().all(|v| v.0.abs() < least.max(3.0 * v.1)) {
            return Ok(());
        }
        let [x, y] = [x, y].map(|v| (v.0 * scale, v.1 * scale.abs()));
        outln!(
            "the rig file's {what}: {:+.2} +- {:.2} {unit} in x, {:+.2} +- {:.2} {unit} in y \
             against this recording; --camera corrects it",
            x.0,
            x.1,
            y.0,
            y.1
        )
    };
    shown("camera.position is off by", found.camera_offset, -1e3, "mm", 3e-3)?;
    let degrees = 1f64.to_degrees();
    shown("camera.orientation is tilted by", found.camera_tilt, -degrees, "deg", 3e-3)?;
    let (offset, sigma) = found.time_offset;
    if offset.abs() > (5.0 * sigma).max(0.01) {
        outln!(
            "the stamps of joint_states are {:.0} ms (std dev {:.0} ms) {} those of the images; \
             correct the clocks, or set clock.climber_offset of pose_fusion to {:.3}",
            1e3 * offset.abs(),
            1e3 * sigma,
            if offset > 0.0 { "behind" } else { "ahead of" },
            -offset
        )?;
    }
    Ok(())
}
