//! `volant demo`: the main job on a simulated rig: four separate nodes, live over DDS.

use anyhow::{Context, Result};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use node_kit::environment::Network;
use node_kit::{files, outln};
use rig_model::Stamp;
use rig_simulator::parallel;
use std::{path::PathBuf, sync::Arc};
use volant::{
    command_line::number,
    report::{Block, Curve, Page, Run as Drawn, Section, Table, colors, six_curves},
};
use volant_test::{
    accuracy::{AXES, Errors, THRESHOLD, UNITS, inertial_alone},
    live::{Ended, ImageSequence, Run, Scenario, Site, bag, quantile, scenario::IMAGE_RATE},
    report::table,
    run_folder::RunFolder,
};

/// Run the four nodes as separate processes, live over DDS, on a simulated rig.
///
/// A rendered camera, an Xsens IMU on a pseudo-terminal and encoders feed marker_tracker,
/// imu_driver, climber_driver and pose_fusion as hardware would. The run ends with a table of
/// errors against the truth, a bag and a figure.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Folder for bag, image and logs: an empty or new one, or that of an earlier run, which is
    /// replaced
    #[arg(long, default_value = "demo_run")]
    out: PathBuf,
    /// Length of the swing, s
    #[arg(long, default_value_t = 20.0, value_parser = number(4.0..=600.0))]
    seconds: f64,
    /// Random seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Add distractors in the markers' colors
    #[arg(long)]
    clutter: bool,
}

fn bar(length: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    let style = ProgressStyle::with_template("{prefix:<26} [{bar:34}] {pos:>4}/{len} {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    bar.set_prefix(what.to_owned());
    bar
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let mut scenario = Scenario::swing(arguments.seed, arguments.seconds)?;
    scenario.scene.clutter = arguments.clutter;
    let network = Network::from_environment()?;
    let _folder = RunFolder::create(&arguments.out)?;

    let shooting = bar(0, "rendering the camera");
    let images = ImageSequence::render(&scenario, parallel::processors().min(4), |done, of| {
        shooting.set_length(of as u64);
        shooting.set_position(done as u64);
    })?;
    shooting.finish();

    let starting = ProgressBar::new_spinner();
    starting.set_message("starting marker_tracker, imu_driver, climber_driver, pose_fusion");
    starting.enable_steady_tick(std::time::Duration::from_millis(120));
    let mut run = Run::start(&scenario, Arc::new(images), &Site::here(&network), &arguments.out)?;
    run.wait_for_pose(20.0)?;
    starting.finish_and_clear();
    let ids: Vec<String> = run.nodes.0.iter().map(|n| format!("{} ({})", n.name, n.id())).collect();
    outln!("four nodes on DDS domain {}: {}", network.domain_id, ids.join(", "))?;

    let epoch = run.begin();
    let playing = bar((scenario.duration() * 10.0) as u64, "live [0.1 s]");
    run.play_until(scenario.duration() + 0.3, |t, hardware| {
        playing.set_position((t.max(0.0) * 10.0) as u64);
        let received = hardware.received();
        if let Some((_, last)) = received.odometry.last() {
            let p = &last.pose.pose.position;
            let covered =
                scenario.covers.iter().find(|c| (c.seconds[0]..c.seconds[1]).contains(&t));
            let covered = covered.map_or(String::new(), |c| format!("  {} covered", c.color));
            playing.set_message(format!("x {:+.3} y {:+.3} z {:.3} m{covered}", p.x, p.y, p.z));
        }
    })?;
    playing.finish_with_message("");
    let ended = run.finish()?;
    conclude(arguments, &scenario, epoch, &ended)
}

fn conclude(arguments: &Arguments, scenario: &Scenario, epoch: Stamp, ended: &Ended) -> Result<()> {
    let received = &ended.received;
    let truth = |at: Stamp| scenario.motion.world_from_volant(at.seconds_since(epoch));
    // The first second is the filter's to settle, as `volant evaluate` has it.
    let (from, to) = (epoch.plus_seconds(1.0), epoch.plus_seconds(scenario.duration()));
    let (camera, fused, samples) = (received.visual(), received.fused(), received.inertial());
    let first = fused
        .iter()
        .find(|(at, _)| *at >= epoch)
        .context("no fused pose since the swing began; see the nodes' logs")?;
    let inertial = inertial_alone(scenario, &samples, first, THRESHOLD);
    let errors = |track| Errors::of(track, from, to, truth);
    let (of_camera, of_inertial, of_fused) = (errors(&camera), errors(&inertial), errors(&fused));
    let rows = [("camera alone", &of_camera), ("IMU alone", &of_inertial), ("fused", &of_fused)];
    outln!(
        "\nerrors against the truth, {} s to {} s (the paper's Table II)\n",
        1,
        scenario.duration()
    )?;
    outln!("{}\n", table(&rows))?;

    let expected = samples.iter().filter(|s| s.stamp >= from && s.stamp <= to).count();
    let gap = fused
        .windows(2)
        .filter(|w| w[0].0 >= from && w[1].0 <= to)
        .map(|w| w[1].0.seconds_since(w[0].0))
        .fold(0.0, f64::max);
    let nees = received.nees(from, to, truth);
    let mean = |k: usize| nees.iter().map(|(_, n)| n[k]).sum::<f64>() / nees.len() as f64;
    let latencies = received.latencies(from, to);
    let numbers = [
        (
            "odometry",
            format!(
                "{} of {expected} IMU samples, longest gap {:.0} ms",
                of_fused.count,
                gap * 1e3
            ),
        ),
        (
            "consistency",
            format!("NEES of position {:.2}, of rotation {:.2} (ideal 3)", mean(0), mean(1)),
        ),
        (
            "latency",
            format!(
                "from an image's stamp to the odometry that contains it, over DDS: median {:.1} \
                 ms, p99 {:.1} ms of {} images (one image period: {:.1} ms)",
                quantile(&latencies, 0.5) * 1e3,
                quantile(&latencies, 0.99) * 1e3,
                latencies.len(),
                1e3 / IMAGE_RATE
            ),
        ),
    ]
    .map(|(name, text)| (name.to_owned(), text));
    for (name, text) in &numbers {
        outln!("{name}: {text}")?;
    }
    for (name, status) in &ended.ends {
        if !status.success() {
            outln!("{name} ended with {status}")?;
        }
    }

    let bag_path = arguments.out.join("bag");
    bag::write(&bag_path, scenario, epoch, received)?;
    let image = arguments.out.join("curves.svg");
    let shaded: Vec<[f64; 2]> = scenario.covers.iter().map(|c| c.seconds).collect();
    let svg = six_curves(
        &Drawn {
            title: "Pose of the platform: camera alone, IMU alone, fused (the paper's \
                    Fig. 13)",
            epoch,
            seconds: scenario.duration(),
            truth: &|t| Some(scenario.motion.world_from_volant(t)),
            shaded: &shaded,
        },
        &[
            Curve { name: "camera alone", track: &camera, color: colors::CAMERA, width: 0 },
            Curve { name: "IMU alone", track: &inertial, color: colors::INERTIAL, width: 2 },
            Curve { name: "fused", track: &fused, color: colors::FUSED, width: 3 },
        ],
    )?;
    let page = arguments.out.join("report.html");
    files::write(&image, svg.as_bytes(), false)?;
    let text = demo_page(arguments, &rows, &numbers, svg).render();
    files::write(&page, text.as_bytes(), false)?;
    outln!("\nbag      {}", bag_path.display())?;
    outln!("rig file {}", arguments.out.join("rig.yaml").display())?;
    outln!("figure   {}", image.display())?;
    outln!("report   {}", page.display())?;
    outln!("logs     {}", arguments.out.join("*.log").display())?;
    Ok(())
}

/// The run as a page.
fn demo_page(
    arguments: &Arguments,
    rows: &[(&str, &Errors); 3],
    numbers: &[(String, String)],
    svg: String,
) -> Page {
    let mut errors = Table { head: vec!["RMSE".into()], rows: Vec::new() };
    errors.head.extend(rows.iter().map(|(name, _)| (*name).to_owned()));
    let mut row = |name: String, value: &dyn Fn(&Errors) -> f64| {
        let values: Vec<f64> = rows.iter().map(|(_, e)| value(e)).collect();
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let mut cells = vec![(name, false)];
        cells.extend(values.iter().map(|v| (format!("{v:.3}"), *v == least)));
        errors.rows.push(cells);
    };
    for (i, (axis, unit)) in AXES.iter().zip(UNITS).enumerate() {
        row(format!("{axis} [{unit}]"), &|e| e.rmse[i]);
    }
    row("3-D [mm]".into(), &|e| e.position_rmse);
    row("angle [deg]".into(), &|e| e.rotation_rmse);
    let (seed, seconds) = (arguments.seed, arguments.seconds);
    let command = format!("`volant demo --seed {seed} --seconds {seconds}`");
    let mut facts = vec![("Command".to_owned(), command)];
    facts.extend(numbers.iter().cloned());
    let words = "Position in millimeters and rotation in degrees, against the truth (thin line). \
                 What leaves a panel has left the \
                 range of the truth: the IMU's doubly integrated acceleration drifts. \
                 The camera alone is shown \
                 where one image determines a pose.";
    Page {
        title: "A live run on the simulated rig".into(),
        lead: "Four nodes as processes of their own, live over DDS: marker_tracker, imu_driver, \
               climber_driver and pose_fusion. \
               They were fed by a rendered camera, an emulated Xsens IMU on a pseudo-terminal and \
               encoder readings; the nodes cannot distinguish them from hardware."
            .into(),
        facts,
        sections: vec![
            Section {
                id: "errors".into(),
                title: "Errors against the truth, without the first second".into(),
                blocks: vec![Block::Table(errors)],
            },
            Section {
                id: "curves".into(),
                title: "The six curves".into(),
                blocks: vec![Block::text(words), Block::Figure(svg)],
            },
        ],
    }
}
