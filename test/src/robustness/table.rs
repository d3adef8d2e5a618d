//! The table: every perturbation on every recording, alone and in pairs, against its largest
//! allowed error.

use super::{
    perturbation::{Perturbation, TABLE},
    recording::climber_speed,
    score::{self, Figures, Scored},
};
use pose_fusion::FusionConfig;
use rig_simulator::recording::Recording;
use std::mem::discriminant;
use volant::report::Table;

/// No pose further off than this may be called valid, m.
const WRONG: f64 = 1.0;
/// Largest share of valid poses beyond three sigma.
const BEYOND: f64 = 0.005;
/// What is measured after a fault begins this long after its end, s.
const SETTLED: f64 = 1.0;

/// What a perturbation may cost. `None` is not limited.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// Position RMSE over that of the unchanged recording.
    pub factor: Option<f64>,
    /// The same, from one second after the fault on.
    pub after: Option<f64>,
    /// Largest position error, mm.
    pub worst: Option<f64>,
    /// Mean NEES of position and rotation.
    pub nees: Option<f64>,
    /// Share of the valid poses that are further off than three sigma.
    pub beyond: Option<f64>,
}

/// Returns what a perturbation may cost on a recording.
pub fn limits(perturbation: &Perturbation, recording: &Recording) -> Limits {
    use Perturbation::*;
    let factor = |x: f64| Limits { factor: Some(x), ..Limits::default() };
    let bounded = Limits { after: Some(1.5), beyond: Some(BEYOND), ..Limits::default() };
    match *perturbation {
        GyroScale(x) if x.abs() < 0.003 => factor(1.1),
        GyroScale(x) if x.abs() < 0.01 => factor(1.15),
        GyroScale(x) if x.abs() < 0.03 => factor(1.8),
        GyroScale(_) => factor(6.0),
        AccelerometerScale(_) => factor(1.2),
        ImuMisaligned(_) | ImuYaw(_) => factor(1.4),
        CameraMounting(_) | FocalLength(_) | Layout(_) | MarkerOff(_) | EncoderScale(_) => {
            Limits { nees: Some(60.0), ..Limits::default() }
        }
        EncoderDelay(delay) => Limits {
            // Millimeters beside what the climber moves in that time.
            worst: Some(climber_speed(recording) * delay.abs() * 1e3 + 5.0),
            ..Limits::default()
        },
        EncoderOff(_, 0.0) => factor(1.2),
        EncoderOff(_, duration) if duration < 0.5 => factor(2.0),
        EncoderOff(..) => Limits { worst: Some(100.0), after: Some(1.2), ..Limits::default() },
        EncoderFrozen(_) | AxisFrozen(..) | AllLost(_) | ImuZeros(_) | ImuStuck(_)
        | ImuSpike(_) | ImuLost(_) | EncodersLost(_) | ImagesLost(_) => bounded,
        GyroSaturated(_) => Limits { beyond: Some(BEYOND), ..Limits::default() },
        // The offset is found while the platform moves, within some seconds.
        CameraDelay(_) => Limits { after: Some(1.2), ..Limits::default() },
        ClockStep(_) => Limits { beyond: Some(0.02), after: Some(1.5), ..Limits::default() },
        // The mean of some readings.
        EncoderNoise(_) => Limits { nees: Some(6.0), ..factor(4.0) },
        // Each image is worth less, and the IMU goes on between them.
        ImageJitter(_) => Limits { after: Some(2.5), ..factor(2.0) },
        // 5 sigma of the markers.
        CameraShake(_) | CameraVibration(..) => {
            Limits { after: Some(4.0), nees: Some(6.0), ..factor(2.5) }
        }
        ImuTwice => factor(1.01),
        ImuBursts(_) => Limits { factor: Some(1.3), beyond: Some(BEYOND), ..Limits::default() },
        // An exchange that no fourth marker contradicts may move the pose, within its sigma.
        Exchanged(_) => Limits { after: Some(1.2), beyond: Some(BEYOND), ..Limits::default() },
    }
}

/// One perturbation on one recording.
#[derive(Clone, Debug)]
pub struct Cell {
    pub whole: Figures,
    /// Figures from one second after the fault on.
    pub after: Figures,
    pub failures: Vec<String>,
    /// What never may happen: a number that is not finite, or a valid pose that is `WRONG`.
    pub catastrophe: Option<String>,
}

/// From when a recording is measured, s: recordings of real motion begin with the tracker's first
/// images.
fn begin(recording: &Recording) -> f64 {
    if recording.name.starts_with("real") { 3.0 } else { 1.0 }
}

fn catastrophe(scored: &Scored, whole: &Figures) -> Option<String> {
    if scored.non_finite {
        return Some("a number that is not finite".to_owned());
    }
    let all = scored.figures(0.0, f64::INFINITY);
    if all.count == 0 {
        return Some("no pose".to_owned());
    }
    let worst = all.worst_valid.max(whole.worst_valid);
    (worst > WRONG).then(|| format!("a valid pose {worst:.1} m wrong"))
}

/// A recording with the figures of its unchanged run.
pub struct Bench {
    recording: Recording,
    config: FusionConfig,
    /// Beginning of perturbations of limited duration, s after the first truth.
    perturbed_from: f64,
    unchanged: Scored,
}

impl Bench {
    /// Runs the unchanged recording.
    pub fn new(recording: Recording, config: FusionConfig, perturbed_from: f64) -> Self {
        let unchanged = score::run(&recording, &config);
        Self { recording, config, perturbed_from, unchanged }
    }

    pub fn unchanged(&self) -> Figures {
        self.unchanged.figures(begin(&self.recording), f64::INFINITY)
    }

    pub fn name(&self) -> &str {
        &self.recording.name
    }

    fn figures(&self, scored: &Scored, perturbation: &Perturbation) -> [Figures; 2] {
        let duration = Some(perturbation.duration()).filter(|d| d.is_finite()).unwrap_or(0.0);
        let settled = self.perturbed_from + duration + SETTLED;
        [begin(&self.recording), settled].map(|from| scored.figures(from, f64::INFINITY))
    }

    pub fn single(&self, perturbation: &Perturbation) -> Cell {
        let mut changed = self.recording.clone();
        perturbation.apply_from(self.perturbed_from, &mut changed);
        let scored = score::run(&changed, &self.config);
        let [whole, after] = self.figures(&scored, perturbation);
        let [base, base_after] = self.figures(&self.unchanged, perturbation);
        let limits = limits(perturbation, &self.recording);
        let mut failures = Vec::new();
        let mut check = |what: &str, limit: Option<f64>, value: f64| {
            if let Some(limit) = limit.filter(|limit| value.is_nan() || value > *limit) {
                failures.push(format!("{what} {value:.3} > {limit:.3}"));
            }
        };
        check("×", limits.factor, whole.position[0] / base.position[0]);
        check("× after", limits.after, after.position[0] / base_after.position[0]);
        check("worst mm", limits.worst, whole.position[1]);
        check("NEES", limits.nees, whole.nees[0].max(whole.nees[1]));
        check("beyond 3σ", limits.beyond, whole.beyond);
        let catastrophe = catastrophe(&scored, &whole);
        Cell { whole, after, failures, catastrophe }
    }

    /// Runs the recording with two changes; returns what never may happen.
    pub fn pair(&self, first: &Perturbation, second: &Perturbation) -> Option<String> {
        let mut changed = self.recording.clone();
        first.apply_from(self.perturbed_from, &mut changed);
        second.apply_from(self.perturbed_from, &mut changed);
        let scored = score::run(&changed, &self.config);
        catastrophe(&scored, &scored.figures(begin(&self.recording), f64::INFINITY))
    }
}

/// Returns all pairs of perturbations of different kinds: two of one kind are another one of it. A
/// step of the clock starts the pose again, with the encoders: were they wrong meanwhile, nothing
/// would show it.
pub fn pairs() -> Vec<(Perturbation, Perturbation)> {
    let paired = |p: &&Perturbation| !matches!(p, Perturbation::ClockStep(_));
    let later = |i: usize| TABLE.iter().filter(paired).skip(i + 1);
    let other = |a: &Perturbation, b: &Perturbation| discriminant(a) != discriminant(b);
    let pairs = |(i, a): (usize, &Perturbation)| {
        let a = *a;
        later(i).filter(move |b| other(&a, b)).map(move |b| (a, *b))
    };
    TABLE.iter().filter(paired).enumerate().flat_map(pairs).collect()
}

/// Returns the table as Markdown. A cell is the position RMSE over that of the unchanged run, the
/// largest error and the NEES of position and rotation; what does not hold is in bold.
pub fn markdown(benches: &[Bench], rows: &[(Perturbation, Vec<Cell>)]) -> String {
    let unchanged: Vec<Figures> = benches.iter().map(Bench::unchanged).collect();
    let row = |name: &str, cell: &dyn Fn(usize) -> String| -> Vec<String> {
        std::iter::once(name.to_owned()).chain((0..benches.len()).map(cell)).collect()
    };
    let head = row("perturbation", &|i| benches[i].name().to_owned()).join(" | ");
    let mut lines = vec![row("none: mm, °, NEES", &|i| {
        let Figures { position: [position, _], rotation: [rotation, _], nees, .. } = unchanged[i];
        format!("{position:.2}, {rotation:.3}, {:.1} / {:.1}", nees[0], nees[1])
    })];
    for (perturbation, cells) in rows {
        lines.push(row(&perturbation.to_string(), &|i| {
            let Figures { position: [position, worst], nees, .. } = cells[i].whole;
            let factor = position / unchanged[i].position[0];
            let holds = cells[i].failures.is_empty() && cells[i].catastrophe.is_none();
            let mark = if holds { "" } else { "**" };
            format!("{mark}{factor:.2}{mark}, {worst:.0} mm, {:.1} / {:.1}", nees[0], nees[1])
        }));
    }
    Table::new(&head, lines).to_markdown()
}
