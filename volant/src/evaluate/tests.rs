use super::*;
use bag::{BagWriter, Qos, Topic, WriteOptions};
use rig_model::topics::absolute::{GROUND_TRUTH, ODOMETRY};
use std::path::Path;

const START: i64 = 1_700_000_000_000_000_000;

/// Times at 100 Hz, s.
fn at_100_hz(seconds: f64) -> Vec<f64> {
    (0..(100.0 * seconds) as u32).map(|i| f64::from(i) * 0.01).collect()
}

/// Writes odometry at a place on the x axis, m, known to 1 mm. It is stamped at times after
/// [`START`], s, on each topic, and logged `late` s after its stamps.
fn odometry(path: &Path, topics: &[(&str, &[f64])], late: f64, x: f64) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    for (topic, times) in topics {
        let topic = bag.add_topic(Topic::of::<Odometry>(topic, &Qos::RELIABLE));
        for time in *times {
            let stamp = Stamp::from_nanos(START).plus_seconds(*time);
            let mut message =
                Odometry { header: convert::header("world", stamp), ..Odometry::default() };
            message.pose.pose.orientation.w = 1.0;
            message.pose.pose.position.x = x;
            message.pose.covariance = std::array::from_fn(|i| if i % 7 == 0 { 1e-6 } else { 0.0 });
            let logged = u64::try_from(stamp.plus_seconds(late).as_nanos()).unwrap();
            bag.write_message(topic, logged, &message).unwrap();
        }
    }
    bag.finish().unwrap();
}

fn options(folder: &Path) -> EvaluateOptions {
    let [estimates, truth] = ["out.mcap", "truth.mcap"].map(|name| folder.join(name));
    EvaluateOptions { estimates, truth, skip: 1.0, names: TopicNames::default() }
}

#[test]
fn a_recording_of_a_played_bag_is_evaluated_by_its_stamps() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    odometry(&options.truth, &[(GROUND_TRUTH, &at_100_hz(3.0))], 0.0, 0.0);
    for late in [0.0, 3600.0, -3600.0] {
        let _ = std::fs::remove_file(&options.estimates);
        odometry(&options.estimates, &[(ODOMETRY, &at_100_hz(3.0))], late, 0.0);
        let evaluation = evaluate(&options).unwrap();
        assert_eq!(evaluation.estimates[0].count, 200, "logged {late} s late");
        assert_eq!(evaluation.began, Stamp::from_nanos(START));
    }
}

#[test]
fn an_estimate_of_which_nothing_was_compared_has_no_figures() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    odometry(&options.truth, &[(GROUND_TRUTH, &at_100_hz(3.0))], 0.0, 0.0);
    // The smoothed odometry ends within the first second.
    let both = [(ODOMETRY, &[0.0, 2.0][..]), ("/volant/smoothed_odometry", &[0.0, 0.5])];
    odometry(&options.estimates, &both, 0.0, 0.0);
    let evaluation = evaluate(&options).unwrap();
    let [compared, nothing] = &evaluation.estimates[..] else { panic!("{evaluation:?}") };
    assert_eq!((compared.count, compared.position_mm.max, nothing.count), (1, 0.0, 0));
    assert!(nothing.position_mm.rmse.is_nan() && nothing.axes_mm[0].max.is_nan());
    let text = table(&evaluation);
    let position = text.lines().find(|line| line.starts_with("position")).unwrap();
    assert!(position.contains("0.000 / 0.000") && position.ends_with("- / -"), "{text}");
    assert!(csv(&evaluation).contains("\nvolant/smoothed_odometry,0,,,"));
    let json = serde_json::to_value(&evaluation).unwrap();
    assert!(json["estimates"][1]["position_mm"]["rmse"].is_null());
}

#[test]
fn an_error_names_the_skipped_time_that_is_longer_than_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let options = EvaluateOptions { skip: 10.0, ..options(folder.path()) };
    odometry(&options.truth, &[(GROUND_TRUTH, &at_100_hz(3.0))], 0.0, 0.0);
    odometry(&options.estimates, &[(ODOMETRY, &at_100_hz(3.0))], 0.0, 0.0);
    let error = evaluate(&options).unwrap_err().to_string();
    assert!(error.contains("out.mcap: --skip 10 ") && error.contains("lasts 3.0 s"), "{error}");
}

#[test]
fn the_page_has_the_table_the_curves_and_the_losses() {
    let folder = tempfile::tempdir().unwrap();
    let estimates = folder.path().join("my out.mcap");
    let options = EvaluateOptions { estimates, ..options(folder.path()) };
    odometry(&options.truth, &[(GROUND_TRUTH, &at_100_hz(3.0))], 0.0, 0.0);
    odometry(&options.estimates, &[(ODOMETRY, &at_100_hz(3.0))], 0.0, 0.002);
    let mut evaluation = evaluate(&options).unwrap();
    evaluation.losses.push("the bag was cut".into());
    let html = page(&evaluation, &options).unwrap().render();
    let command = format!("volant evaluate '{}' --truth ", options.estimates.display());
    for part in [&*command, "2.000 / 2.000", "the bag was cut", "error [mm]"] {
        assert!(html.contains(part), "{part}");
    }
    assert_eq!(html.matches("<figure>").count(), 2);
    let [fused] = &evaluation.estimates[..] else { panic!("{evaluation:?}") };
    assert!((fused.axes_mm[0].rmse - 2.0).abs() < 1e-9 && fused.axes_mm[1].max < 1e-9);
    assert!(table(&evaluation).contains("4.0"), "NEES of 2 sigma on one axis");
}
