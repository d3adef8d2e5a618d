//! Replay of the recorded runs: the same bytes each time, the tracked figures, and the smoother.
//!
//! The recordings are found through `VOLANT_SHARED`; without it their tests are skipped.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod place;
mod simulated;

use bag::BagReader;
use place::{Place, Ran, copy_bag};
use rig_model::topics;
use simulated::Simulated;
use std::{
    fs,
    path::{Path, PathBuf},
};
use volant::{
    evaluate::{EvaluateOptions, Quality, evaluate},
    replay::TopicNames,
};
use volant_msgs::{Message, cdr, geometry_msgs::msg::TransformStamped, sensor_msgs::msg::Imu};

const BAGS: [&str; 4] = ["nominal", "occlude_two", "fast_swing", "clutter"];
/// Recorded without images, with real IMU samples that have no attitude.
const WITHOUT_IMAGES: [&str; 3] = ["real_slow", "real_fast", "real_tapping"];
/// Selects the published system as a whole.
const PUBLISHED: &str = "--params-file published.yaml";
/// Its name in the tracked table.
const WHOLE: &str = "published system";
/// Variable that makes the test write the figures; the commit explains the change.
const UPDATE: &str = "VOLANT_UPDATE_FIGURES";

/// The recordings, and a folder for replays of them.
struct Replays {
    bags: PathBuf,
    place: Place,
}

impl Replays {
    fn new() -> Option<Self> {
        let bags = test_support::recordings()?.join("bags").canonicalize().unwrap();
        let place = Place::new();
        place.write("published.yaml", include_str!("../../launch_config/config/paper.yaml"));
        Some(Self { bags, place })
    }

    /// Replays a recording with further words; returns the bag that it writes.
    fn replay(&self, bag: &str, more: &str) -> PathBuf {
        let folder = self.bags.join(bag);
        let folder = folder.display();
        self.place.done(&format!(
            "replay {folder}/in.mcap --rig {folder}/rig.yaml --out out.mcap --overwrite {more}"
        ));
        self.place.path("out.mcap")
    }

    /// Errors of a replay's estimates after the first second.
    fn qualities(&self, bag: &str, estimates: PathBuf) -> Vec<Quality> {
        let truth = self.bags.join(bag).join("truth.mcap");
        let options = EvaluateOptions { estimates, truth, skip: 1.0, names: TopicNames::default() };
        evaluate(&options).unwrap().estimates
    }
}

/// The filter rejects it, and it does not become the end of the output.
#[test]
fn a_transform_stamped_in_another_year_does_not_stretch_the_output() {
    let (place, simulated) = (Place::with_rig(rig_simulator::RIG_YAML), Simulated::new(5));
    simulated.write(&place.path("in.mcap"), &simulated.motion(5.0, false), true);
    let mut count = 0;
    copy_bag(&place.path("in.mcap"), &place.path("changed.mcap"), |topic, message| {
        count += u32::from(topic.type_name == TransformStamped::TYPE_NAME);
        if count == 100 && topic.type_name == TransformStamped::TYPE_NAME {
            let mut transform: TransformStamped = cdr::from_bytes(&message.data).unwrap();
            transform.header.stamp.sec += 10 * 365 * 86_400;
            message.data = cdr::to_bytes(&transform);
        }
    });
    let printed = place.done("replay changed.mcap --rig rig.yaml --out out.mcap");
    assert!(printed.contains("ahead of the IMU"), "{printed}");
    let left_out = |line: &&str| line.contains("is left out of the output");
    assert_eq!(printed.lines().filter(left_out).count(), 1, "{printed}");
    let (start, end) = BagReader::summary(&place.path("out.mcap")).unwrap().span.unwrap();
    assert!(end - start < 10_000_000_000, "{start} to {end}");
}

/// A bag that was played and recorded again is logged years after its stamps.
#[test]
fn a_bag_that_was_recorded_again_is_replayed_at_its_stamps() {
    let (place, simulated) = (Place::with_rig(rig_simulator::RIG_YAML), Simulated::new(5));
    simulated.write(&place.path("in.mcap"), &simulated.motion(5.0, false), true);
    copy_bag(&place.path("in.mcap"), &place.path("again.mcap"), |_, message| {
        message.log_time += 3 * 365 * 86_400 * 1_000_000_000;
    });
    place.done("replay again.mcap --rig rig.yaml --out out.mcap");
    let summary = BagReader::summary(&place.path("out.mcap")).unwrap();
    let (start, end) = summary.span.unwrap();
    assert!(end - start < 10_000_000_000, "{start} to {end}");
    assert_eq!(summary.count("/tf_static"), 1);
}

/// The filter rejects such samples and goes on without the IMU, and the output with it.
#[test]
fn imu_samples_without_a_stamp_leave_nothing_out_of_the_output() {
    let (place, simulated) = (Place::with_rig(rig_simulator::RIG_YAML), Simulated::new(5));
    let [input, changed, output] = ["in.mcap", "changed.mcap", "out.mcap"].map(|n| place.path(n));
    simulated.write(&input, &simulated.motion(5.0, false), true);
    for first in [0, 200] {
        let mut count = 0;
        let _ = fs::remove_file(&changed);
        copy_bag(&input, &changed, |topic, message| {
            if topic.type_name == Imu::TYPE_NAME {
                count += 1;
                if count > first {
                    let mut imu: Imu = cdr::from_bytes(&message.data).unwrap();
                    (imu.header.stamp.sec, imu.header.stamp.nanosec) = (0, 0);
                    message.data = cdr::to_bytes(&imu);
                }
            }
        });
        place.done("replay changed.mcap --rig rig.yaml --out out.mcap --overwrite");
        let [before, after] = [&input, &output].map(|bag| BagReader::summary(bag).unwrap());
        for topic in [topics::absolute::MARKERS, topics::absolute::CLIMBER_TRANSFORM] {
            assert_eq!(before.count(topic), after.count(topic), "{topic} from {first} on");
        }
        assert!(after.count(topics::absolute::ODOMETRY) > 0);
    }
}

#[test]
fn a_replay_writes_the_same_bytes_each_time_with_one_thread_or_many() {
    let Some(replays) = Replays::new() else { return };
    for system in ["", PUBLISHED] {
        let outs = [1, 1, 5].map(|threads| {
            let out = replays.replay("occlude_two", &format!("{system} --threads {threads}"));
            fs::read(out).unwrap()
        });
        assert!(outs[0] == outs[1], "{system:?}: two replays differ");
        assert!(outs[0] == outs[2], "{system:?}: the number of threads changes the result");
    }
}

#[test]
fn a_replay_ends_with_what_is_wrong_in_the_rig_file() {
    let Some(replays) = Replays::new() else { return };
    let bag = replays.bags.join("nominal");
    let text = fs::read_to_string(bag.join("rig.yaml")).unwrap();
    let line = text.lines().find(|line| line.trim().starts_with("red:")).unwrap();
    let (before, x) = line.split_once('[').unwrap();
    let (x, rest) = x.split_once(',').unwrap();
    let x: f64 = x.trim().parse().unwrap();
    let moved = format!("{before}[{:.4},{rest}", x + 0.005);
    let (place, input) = (&replays.place, bag.join("in.mcap"));
    place.write("rig.yaml", &text);
    place.write("my rig.yaml", text.replace(line, &moved));
    place.write("more.yaml", "marker_tracker: {ros__parameters: {max_predicted: 6}}\n");
    let command =
        format!("`volant check {} --rig 'my rig.yaml' --params-file more.yaml`", input.display());
    for (rig, found) in [("rig.yaml", false), ("my rig.yaml", true)] {
        let mut replay = place.command("replay --out out.mcap --overwrite --params-file more.yaml");
        replay.arg(&input).args(["--rig", rig]);
        let Ran { status, err: said, .. } = replay.output().unwrap().into();
        assert_eq!(status, Some(0), "{said}");
        let finding = said.lines().find(|line| line.contains("rig file:"));
        let named = finding.is_some_and(|line| {
            line.contains("`markers`") && line.contains(&command) && line.contains("mm")
        });
        assert_eq!((finding.is_some(), named), (found, found), "{said}");
    }
}

#[test]
fn the_nodes_parameter_file_sets_the_replay_as_it_sets_the_nodes() {
    let Some(replays) = Replays::new() else { return };
    let written = |more: &str| fs::read(replays.replay("nominal", more)).unwrap();
    let usual = written("");
    // Of another node, of the same node in another namespace, and defaults.
    replays.place.write(
        "others.yaml",
        "imu_driver: {ros__parameters: {port: /dev/ttyS9}}\n/there/pose_fusion: {ros__parameters: \
         {model: paper}}\n\
         /**: {ros__parameters: {use_sim_time: false, port: /dev/ttyS8, max_predicted: 6, \
         markers: {gate: 16.0}}}\n",
    );
    assert!(written("--params-file others.yaml") == usual);
    let paper = "pose_fusion: {ros__parameters: {model: paper}}\n";
    replays.place.write("paper.yaml", paper);
    assert!(written("--params-file paper.yaml") == written("--model paper"));
    assert!(written("--params-file paper.yaml --model tight") == usual);
    assert!(written("--params-file others.yaml --params-file paper.yaml") != usual);
    let tracker = "marker_tracker: {ros__parameters: {max_centroid_sigma: 0.02}}\n";
    replays.place.write("tracker.yaml", tracker);
    assert!(written("--params-file tracker.yaml") != usual);
}

#[test]
fn the_default_filter_runs_on_the_published_tracker() {
    let Some(replays) = Replays::new() else { return };
    let out = replays.replay("nominal", &format!("{PUBLISHED} --model tight"));
    let estimates = replays.qualities("nominal", out);
    let fused = estimates.iter().find(|q| q.estimate == topics::ODOMETRY).unwrap();
    let (mm, degrees) = (fused.position_mm.rmse, fused.rotation_deg.rmse);
    assert!(fused.count > 1000 && mm < 5.0 && degrees < 1.5, "{mm} mm, {degrees}°");
}

#[test]
fn smoothed_odometry_is_more_accurate_and_consistent() {
    let Some(replays) = Replays::new() else { return };
    // The recordings have the rig file's calibration: an allowance for its errors would make the
    // covariance too large.
    let sigmas = [
        "calibration.focal_length_sigma",
        "calibration.layout_sigma",
        "calibration.mounting_sigma",
        "calibration.encoder_scale_sigma",
        "clock.climber_sigma",
    ];
    let lines: String = sigmas.map(|name| format!("    {name}: 0.0\n")).concat();
    replays.place.write("exact.yaml", format!("pose_fusion:\n  ros__parameters:\n{lines}"));
    for name in BAGS {
        let out = replays.replay(name, "--smooth --params-file exact.yaml");
        let found = replays.qualities(name, out);
        let of = |topic: &str| found.iter().find(|q| q.estimate == topic).unwrap();
        let (live, smooth) = (of(topics::ODOMETRY), of(topics::SMOOTHED_ODOMETRY));
        println!(
            "{name:12} live {:.3} mm {:.4} deg; smoothed {:.3} mm {:.4} deg, max {:.2} mm, NEES \
             {:.2} {:.2}",
            live.position_mm.rmse,
            live.rotation_deg.rmse,
            smooth.position_mm.rmse,
            smooth.rotation_deg.rmse,
            smooth.position_mm.max,
            smooth.nees_position.unwrap(),
            smooth.nees_rotation.unwrap()
        );
        assert!(smooth.count + 3 >= live.count, "{} of {}", smooth.count, live.count);
        assert!(smooth.position_mm.rmse < live.position_mm.rmse, "{name}");
        assert!(smooth.rotation_deg.rmse < live.rotation_deg.rmse, "{name}");
        let consistent = |nees: Option<f64>| (0.5..6.0).contains(&nees.unwrap());
        assert!(consistent(smooth.nees_position) && consistent(smooth.nees_rotation), "{name}");
    }
}

#[test]
fn a_bag_that_is_cut_is_replayed_up_to_the_cut() {
    let Some(replays) = Replays::new() else { return };
    let (place, bag) = (&replays.place, replays.bags.join("nominal"));
    let bytes = fs::read(bag.join("in.mcap")).unwrap();
    place.write("cut.mcap", &bytes[..bytes.len() / 2]);
    let rig = bag.join("rig.yaml");
    let printed = place.done(&format!("replay cut.mcap --rig {} --out out.mcap", rig.display()));
    assert!(printed.lines().any(|l| l.contains("cut.mcap") && l.contains("cut off")), "{printed}");
    let last = replays.qualities("nominal", place.path("out.mcap"))[0].last_s;
    assert!((5.0..7.0).contains(&last), "half of 12 s: {last}");
}

/// One row of the tracked table.
fn row(bag: &str, model: &str, q: &Quality) -> String {
    let nees = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.3}"));
    format!(
        "{bag},{model},{},{},{:.4},{:.4},{:.5},{:.5},{},{}",
        q.estimate,
        q.count,
        q.position_mm.rmse,
        q.position_mm.max,
        q.rotation_deg.rmse,
        q.rotation_deg.max,
        nees(q.nees_position),
        nees(q.nees_rotation)
    )
}

/// Detects numeric changes: each figure is within 2 % (and the last digits) of the tracked one, and
/// each count is equal. Another processor's rounding changes far less.
#[test]
fn the_figures_are_those_of_the_tracked_table() {
    let Some(replays) = Replays::new() else { return };
    let mut lines = vec![
        "bag,model,estimate,count,position_rmse_mm,position_max_mm,\
         rotation_rmse_deg,rotation_max_deg,nees_position,nees_rotation"
            .to_owned(),
    ];
    let models: [(&str, &str, &[&str]); 4] = [
        ("tight", "--model tight", &BAGS),
        ("paper", "--model paper", &BAGS),
        (WHOLE, PUBLISHED, &BAGS),
        (WHOLE, PUBLISHED, &WITHOUT_IMAGES),
    ];
    for (model, options, names) in models {
        for bag in names {
            for quality in replays.qualities(bag, replays.replay(bag, options)) {
                // The fused pose is the inverted odometry, which another test covers.
                if quality.estimate != topics::FUSED_POSE {
                    lines.push(row(bag, model, &quality));
                }
            }
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/replay_figures.csv");
    let found = lines.join("\n") + "\n";
    if std::env::var_os(UPDATE).is_some() {
        fs::write(&path, found).unwrap();
        return;
    }
    let tracked = fs::read_to_string(&path).unwrap();
    let differences: Vec<String> = compare(&tracked, &found);
    assert!(
        differences.is_empty(),
        "{}\nIf this is intended, run this test with {UPDATE}=1 and explain it in the \
         commit.\n{found}",
        differences.join("\n")
    );
}

fn compare(tracked: &str, found: &str) -> Vec<String> {
    let mut differences = vec![];
    let (old, new): (Vec<&str>, Vec<&str>) = (tracked.lines().collect(), found.lines().collect());
    if old.len() != new.len() || old.first() != new.first() {
        differences.push(format!("{} rows, tracked are {}", new.len(), old.len()));
    }
    let names: Vec<&str> = new[0].split(',').collect();
    for (old, new) in old.iter().zip(&new).skip(1) {
        for (i, (a, b)) in old.split(',').zip(new.split(',')).enumerate() {
            let same = match (a.parse::<f64>(), b.parse::<f64>()) {
                (Ok(a), Ok(b)) if i > 3 => (a - b).abs() <= 0.02 * a.abs() + 2e-3,
                _ => a == b,
            };
            if !same {
                let row: Vec<&str> = new.split(',').take(3).collect();
                differences.push(format!("{}: {} is {b}, tracked is {a}", row.join(" "), names[i]));
            }
        }
    }
    differences
}

#[test]
fn the_comparison_detects_changes() {
    let table =
        "bag,model,estimate,count,position_rmse_mm\nnominal,tight,volant/odometry,1100,0.5000\n";
    assert_eq!(compare(table, table), [] as [String; 0]);
    assert_eq!(compare(table, &table.replace("0.5000", "0.5050")), [] as [String; 0]);
    assert_eq!(compare(table, &table.replace("0.5000", "0.5200")).len(), 1);
    assert_eq!(compare(table, &table.replace("1100", "1099")).len(), 1);
    assert_eq!(compare(table, table.lines().next().unwrap()).len(), 1);
}
