//! Scenes that challenge the tracker, and its results against the truth.

mod scenes;

use crate::{
    methods::Ours,
    report::{self, Csv, number},
    scene::{Canvas, Frame, MarkerTruth, Pinhole, PlateKind, Rng},
};
use anyhow::{Result, bail};
use nalgebra::Vector2;
use rig_model::{MarkerColor, MarkerState};
use scenes::Scene;
use std::path::Path;

/// A marker counts as whole from this share on, as hidden up to the other.
const WHOLE: f64 = 0.995;
const HIDDEN: f64 = 0.02;
/// A detection further off than this is of something else, px.
const WRONG: f64 = 5.0;
/// Normalized squared error above which a frame is saved (exceeded by 1 of 20 000 with a correct
/// covariance).
const SURPRISING: f64 = 20.0;
/// Most images of mistakes that are left per scene, the pixels around the marker that they show,
/// and by how much they are enlarged.
const CLOSEUPS: usize = 24;
const REACH: i32 = 36;
const ENLARGED: usize = 10;

/// Sums over one scene; flat, because each is a column or part of one.
#[derive(Clone, Debug, Default)]
struct Tally {
    images: usize,
    whole: usize,
    whole_detected: usize,
    cut: usize,
    cut_detected: usize,
    /// Cut markers called DETECTED whose error is beyond 4 of their standard deviations and 0.3 px.
    cut_misled: usize,
    hidden: usize,
    hidden_detected: usize,
    wrong: usize,
    /// Longest run of images with a wrong association.
    longest_wrong: usize,
    squared: f64,
    sum: Vector2<f64>,
    nees: f64,
    /// Times that all four came back after all had been lost, and the images that it took beyond
    /// the first.
    returns: usize,
    return_delay: usize,
    delay: Option<usize>,
    running_wrong: usize,
    slowest_us: f64,
}

impl Tally {
    fn add(
        &mut self,
        ours: &Ours,
        truth: &[MarkerTruth; 4],
        report: &mut impl FnMut(String, MarkerColor, &MarkerTruth),
    ) {
        self.images += 1;
        let mut any_wrong = false;
        for (truth, color) in truth.iter().zip(MarkerColor::ALL) {
            let marker = ours.observed.as_ref().map(|o| o.markers[color]);
            let detected = marker.filter(|m| m.state == MarkerState::Detected);
            let error = detected.map(|m| m.centroid - truth.centroid);
            let off = error.is_some_and(|e| e.norm() > WRONG || e.norm().is_nan());
            if off {
                self.wrong += 1;
                any_wrong = true;
            }
            let surprise = detected
                .zip(error)
                .and_then(|(m, e)| Some(e.dot(&(m.covariance.try_inverse()? * e))));
            let note = if truth.shown >= WHOLE {
                self.whole += 1;
                self.whole_detected += usize::from(detected.is_some());
                if let (Some(e), false) = (error, off) {
                    self.squared += e.norm_squared();
                    self.sum += e;
                    self.nees += surprise.unwrap_or(f64::INFINITY).min(1e6);
                }
                if detected.is_none() {
                    "whole, not detected"
                } else if surprise.is_none_or(|s| s > SURPRISING) {
                    "whole, but beyond its covariance"
                } else {
                    ""
                }
            } else if truth.shown > HIDDEN {
                self.cut += 1;
                self.cut_detected += usize::from(detected.is_some());
                let misled =
                    error.is_some_and(|e| e.norm() > 0.3) && surprise.is_none_or(|s| s > 16.0);
                self.cut_misled += usize::from(misled);
                if misled { "cut, but detected as if whole" } else { "" }
            } else {
                self.hidden += 1;
                self.hidden_detected += usize::from(detected.is_some());
                if detected.is_some() { "hidden, but detected" } else { "" }
            };
            let note = if off { "wrong association" } else { note };
            if !note.is_empty() {
                let e = error.unwrap_or(Vector2::repeat(f64::NAN));
                let sigma = marker.map_or(f64::NAN, |m| (m.covariance.trace() / 2.0).sqrt());
                let line = format!(
                    "frame {}: {color} {note}; shown {:.3}, truth ({:.1}, {:.1}), error ({:.2}, \
                     {:.2}), sigma {sigma:.3}, squared {:.0}, {}",
                    self.images - 1,
                    truth.shown,
                    truth.centroid.x,
                    truth.centroid.y,
                    e.x,
                    e.y,
                    surprise.unwrap_or(f64::NAN),
                    ours.account(color).0,
                );
                report(line, color, truth);
            }
        }
        self.running_wrong = if any_wrong { self.running_wrong + 1 } else { 0 };
        self.longest_wrong = self.longest_wrong.max(self.running_wrong);
        self.follow_return(ours, truth);
    }

    fn follow_return(&mut self, ours: &Ours, truth: &[MarkerTruth; 4]) {
        let all = |test: &dyn Fn(f64) -> bool| truth.iter().all(|t| test(t.shown));
        if all(&|s| s <= HIDDEN) {
            self.delay = Some(0);
        } else if let Some(delay) = self.delay
            && all(&|s| s >= WHOLE)
        {
            let found = ours
                .observed
                .as_ref()
                .is_some_and(|o| o.markers.0.iter().all(|m| m.state == MarkerState::Detected));
            if found {
                self.returns += 1;
                self.return_delay += delay;
                self.delay = None;
            } else {
                self.delay = Some(delay + 1);
            }
        }
    }
}

fn run_scene(scene: &Scene, seed: u64, closeups: Option<&Path>) -> Result<Tally> {
    let camera = Pinhole::BENCH;
    let PlateKind::Markers { layout, .. } = &scene.plate.kind else {
        bail!("a trial's plate bears markers")
    };
    let mut ours = Ours::new(&camera, layout.clone());
    let mut canvas = Canvas::new(camera.width, camera.height);
    let mut rng = Rng::new(seed ^ 0x7717);
    let mut tally = Tally::default();
    let mut shown = 0;
    for number in 0..scene.images {
        let moment = (scene.at)(number as f64 / 30.0);
        scene.floor.copy_to(&mut canvas, moment.floor_shift);
        for thing in &moment.under {
            canvas.add(&thing.outline, thing.color, 1.0);
            canvas.flatten();
        }
        scene.plate.draw(&mut canvas, &camera, &moment.poses);
        for thing in &moment.over {
            canvas.add(&thing.outline, thing.color, 1.0);
            canvas.flatten();
        }
        let truth = scene.plate.truth(&camera, &moment.poses, &moment.over);
        let frame = canvas.expose(&moment.light, &mut rng);
        let time = ours.track(&frame);
        tally.slowest_us = tally.slowest_us.max(time.as_secs_f64() * 1e6);
        let mut failed = Ok(());
        tally.add(&ours, &truth, &mut |line, color, truth| {
            let Some(folder) = closeups else { return };
            println!("  {}: {line}", scene.name);
            if shown < CLOSEUPS {
                shown += 1;
                let name = format!("{}-{number}-{color}.png", scene.name.replace(' ', "-"));
                failed = report::write_png(
                    &closeup(&frame, truth.centroid, ours.account(color).1.as_ref()),
                    &folder.join(name),
                );
            }
        });
        failed?;
        if closeups.is_some() {
            for warning in ours.warnings.drain(..) {
                println!("  {}: frame {number}: {warning}", scene.name);
            }
        }
    }
    Ok(tally)
}

/// What is around a place, enlarged: the true centroid as a black cross, the measured outline in
/// white.
fn closeup(frame: &Frame, at: Vector2<f64>, outline: Option<&[Vector2<f64>; 4]>) -> Frame {
    let side = (2 * REACH + 1) as usize * ENLARGED;
    let origin = at.map(|v| v.round() as i32 - REACH);
    let mut rgb = vec![0; 3 * side * side];
    for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        let (x, y) =
            (origin.x + (i % side / ENLARGED) as i32, origin.y + (i / side / ENLARGED) as i32);
        if (0..frame.width as i32).contains(&x) && (0..frame.height as i32).contains(&y) {
            let from = 3 * (y as usize * frame.width + x as usize);
            pixel.copy_from_slice(&frame.rgb[from..from + 3]);
        }
    }
    let mut line = |from: Vector2<f64>, to: Vector2<f64>, value: u8| {
        let steps = 4 * side;
        for i in 0..=steps {
            let p = from + (to - from) * (i as f64 / steps as f64);
            let q = (p - origin.map(f64::from)).map(|v| ((v + 0.5) * ENLARGED as f64).floor());
            if q.x >= 0.0 && q.y >= 0.0 && q.x < side as f64 && q.y < side as f64 {
                let i = 3 * (q.y as usize * side + q.x as usize);
                rgb[i..i + 3].fill(value);
            }
        }
    };
    let (across, down) = (Vector2::new(1.0, 0.0), Vector2::new(0.0, 1.0));
    line(at - across, at + across, 0);
    line(at - down, at + down, 0);
    if let Some(corners) = outline {
        for i in 0..4 {
            line(corners[i], corners[(i + 1) % 4], 255);
        }
    }
    Frame { width: side, height: side, rgb }
}

/// One frame of each scene as PNG.
pub fn images(folder: &Path, seed: u64) -> Result<()> {
    let camera = Pinhole::BENCH;
    let mut canvas = Canvas::new(camera.width, camera.height);
    for scene in scenes::all(seed) {
        let moment = (scene.at)(1.4);
        scene.floor.copy_to(&mut canvas, moment.floor_shift);
        for thing in &moment.under {
            canvas.add(&thing.outline, thing.color, 1.0);
            canvas.flatten();
        }
        scene.plate.draw(&mut canvas, &camera, &moment.poses);
        for thing in &moment.over {
            canvas.add(&thing.outline, thing.color, 1.0);
            canvas.flatten();
        }
        let frame = canvas.expose(&moment.light, &mut Rng::new(seed));
        report::write_png(&frame, &folder.join(format!("{}.png", scene.name.replace(' ', "-"))))?;
    }
    Ok(())
}

/// Every scene (or those whose name contains `only`); prints the table and writes `trials.csv`.
/// Returns how many rows fall short.
pub fn run(folder: &Path, seed: u64, only: &str, verbose: bool) -> Result<usize> {
    println!(
        "{:<28} {:>5} {:>9} {:>11} {:>13} {:>6} {:>7} {:>8} {:>6} {:>12} {:>8}",
        "scene",
        "pict",
        "detected",
        "cut: detected",
        "hidden: detected",
        "wrong",
        "longest",
        "px RMS",
        "NEES",
        "back (late)",
        "max us"
    );
    let mut csv = Csv::new(concat!(
        "scene,images,whole,whole_detected,cut,cut_detected,cut_misled,hidden,",
        "hidden_detected,wrong,longest_wrong,px_rms,nees,returns,return_delay"
    ));
    let mut short = 0;
    for scene in scenes::all(seed).into_iter().filter(|s| s.name.contains(only)) {
        let t = run_scene(&scene, seed, verbose.then_some(folder))?;
        let n = t.whole_detected as f64;
        if verbose {
            println!("  {}: mean error ({:.4}, {:.4}) px", scene.name, t.sum.x / n, t.sum.y / n);
        }
        let (rms, nees) = ((t.squared / (2.0 * n)).sqrt(), t.nees / n);
        let share = if t.whole == 0 { 1.0 } else { n / t.whole as f64 };
        let late = t.return_delay + t.delay.unwrap_or(0);
        let good = share >= scene.wanted
            && t.wrong == 0
            && t.hidden_detected == 0
            && t.cut_misled == 0
            && late == 0;
        short += usize::from(!good);
        println!(
            "{:<28} {:>5} {:>8.2}% {:>4}/{:<3}({:>2}) {:>6}/{:<6} {:>6} {:>7} {:>8} {:>6} {:>6} \
             ({:>3}) {:>8.0}  {}",
            scene.name,
            t.images,
            100.0 * share,
            t.cut_detected,
            t.cut,
            t.cut_misled,
            t.hidden_detected,
            t.hidden,
            t.wrong,
            t.longest_wrong,
            number(rms, 4),
            number(nees, 2),
            t.returns,
            late,
            t.slowest_us,
            if good { "pass" } else { "FAIL" },
        );
        let counts = [
            t.images,
            t.whole,
            t.whole_detected,
            t.cut,
            t.cut_detected,
            t.cut_misled,
            t.hidden,
            t.hidden_detected,
            t.wrong,
            t.longest_wrong,
        ];
        let mut row = vec![scene.name.to_owned()];
        row.extend(counts.iter().map(usize::to_string));
        row.extend([number(rms, 5), number(nees, 3), t.returns.to_string(), late.to_string()]);
        csv.row(&row);
    }
    csv.write(&folder.join("trials.csv"))?;
    Ok(short)
}
