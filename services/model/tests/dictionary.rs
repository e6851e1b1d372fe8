//! Accuracy of a bounded dictionary on a stream like that of a robot: long steady stretches, few
//! excursions.
#![expect(clippy::unwrap_used, reason = "a test ends at the first error")]
#![expect(clippy::print_stderr, reason = "the test prints the figures that it judges")]

use model::gp::dictionary::{Dictionary, Observation, Selection};
use model::gp::fit::{FitOptions, LogNormal, Priors, fit};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::Posterior;
use model::gp::split_mix::SplitMix64;

const D: usize = 6;
const CAPACITY: usize = 200;
const STREAM: usize = 6_000;
const NOISE: f64 = 0.003;

/// A generic wheeled robot. Velocities follow inputs with a lag. Its model is wrong in gain,
/// friction, drag and the bend of its speed curve.
struct Robot {
    velocity: [f64; 3],
    input: [f64; 3],
    until: usize,
    random: SplitMix64,
}

impl Robot {
    fn new(seed: u64) -> Self {
        Self { velocity: [0.0; 3], input: [0.0; 3], until: 0, random: SplitMix64::new(seed) }
    }

    /// One period: the input of the model, and its error there.
    fn step(&mut self) -> Observation<D> {
        if self.until == 0 {
            let excursion = self.random.uniform() < 0.5;
            self.until = if excursion { 25 } else { 300 };
            self.input = if excursion {
                std::array::from_fn(|_| 1.2 * self.random.normal())
            } else {
                [1.5, 0.0, 0.2]
            };
        }
        self.until -= 1;
        let mut input = [0.0; D];
        for axis in 0..3 {
            let asked = self.input[axis] + 0.02 * self.random.normal();
            (input[axis], input[axis + 3]) = (self.velocity[axis], asked - self.velocity[axis]);
            self.velocity[axis] += 0.3 * (asked - self.velocity[axis]);
        }
        let wrong = residual(&input);
        Observation { input, target: wrong.map(|value| value + NOISE * self.random.normal()) }
    }
}

fn residual(input: &[f64; D]) -> [f64; 3] {
    let [v, w, r, slip_v, slip_w, slip_r] = *input;
    [
        -0.10 * slip_v - 0.03 * (v / 0.3).tanh() - 0.006 * v * v.abs() + 0.01 * w * r,
        -0.12 * slip_w - 0.05 * (w / 0.3).tanh() - 0.01 * v * r,
        -0.08 * slip_r - 0.04 * (r / 0.4).tanh() + 0.02 * (1.5 * w).sin(),
    ]
}

/// RMS error over `held_out` of a Gaussian process on `observations`, each with the scale of its
/// noise. Hyperparameters are fitted to at most 300 of them.
fn error(observations: &[(Observation<D>, f64)], held_out: &[Observation<D>]) -> f64 {
    let start = Hyperparameters::new([2.0; D], 0.01, 1e-5).with_linear(0.01);
    let few: Vec<Observation<D>> = observations
        .iter()
        .step_by(observations.len().div_ceil(300))
        .map(|&(observation, _)| observation)
        .collect();
    let few_inputs: Vec<[f64; D]> = few.iter().map(|observation| observation.input).collect();
    let length_scale = [Some(LogNormal { median: 2.0, log_deviation: 1.0 }); D];
    let mut options = FitOptions {
        priors: Some(Priors { length_scale, ..Priors::NONE }),
        max_evaluations: 30,
        ..FitOptions::default()
    };
    options.bounds.lower = Hyperparameters::new([0.1; D], 1e-6, 1e-7).with_linear(1e-6);
    let hyperparameters = std::array::from_fn(|output| {
        let targets: Vec<f64> = few.iter().map(|observation| observation.target[output]).collect();
        fit(&few_inputs, &targets, &start, &options).unwrap().hyperparameters
    });
    let inputs: Vec<[f64; D]> =
        observations.iter().map(|(observation, _)| observation.input).collect();
    let targets: Vec<[f64; 3]> =
        observations.iter().map(|(observation, _)| observation.target).collect();
    let noise_scale: Vec<f64> = observations.iter().map(|&(_, scale)| scale).collect();
    let posterior =
        Posterior::with_noise_scale(&inputs, &targets, &noise_scale, &hyperparameters).unwrap();
    let square = |observation: &Observation<D>| {
        let (mean, truth) = (posterior.mean(&observation.input), residual(&observation.input));
        mean.iter().zip(truth).map(|(mean, truth)| (mean - truth).powi(2)).sum::<f64>()
    };
    (held_out.iter().map(square).sum::<f64>() / held_out.len() as f64).sqrt()
}

fn dictionary() -> Dictionary<D> {
    Dictionary::new(Selection {
        capacity: CAPACITY,
        normalisation: Normalisation::IDENTITY,
        kernel: Hyperparameters::new([1.0; D], 1.0, 0.01).with_linear(1.0),
        memory_samples: 2_000.0,
        noise_floor: [1e-3; 3],
    })
}

#[test]
fn it_predicts_like_two_thousand_points_and_better_than_the_newest_or_random_ones() {
    for seed in 1..=3 {
        let (mut robot, mut set) = (Robot::new(seed), dictionary());
        let stream: Vec<Observation<D>> = (0..STREAM).map(|_| robot.step()).collect();
        for observation in &stream {
            set.insert(*observation);
        }
        let mut other = Robot::new(seed + 100);
        let held_out: Vec<Observation<D>> = (0..STREAM).map(|_| other.step()).collect();
        let alike = |places: &mut dyn Iterator<Item = usize>| -> Vec<(Observation<D>, f64)> {
            places.map(|i| (stream[i], 1.0)).collect()
        };
        let kept: Vec<(Observation<D>, f64)> =
            set.observations().map(|(observation, scale)| (*observation, scale)).collect();
        let mut random = SplitMix64::new(seed);
        let ours = error(&kept, &held_out);
        let full = error(&alike(&mut (0..2_000).map(|i| i * STREAM / 2_000)), &held_out);
        let newest = error(&alike(&mut (STREAM - CAPACITY..STREAM)), &held_out);
        let drawn = error(
            &alike(&mut (0..CAPACITY).map(|_| (random.uniform() * STREAM as f64) as usize)),
            &held_out,
        );
        let figures = format!(
            "seed {seed}: dictionary {ours:.5}, 2000 points {full:.5}, newest {newest:.5}, \
             random {drawn:.5}"
        );
        eprintln!("{figures}");
        assert!(ours <= 1.10 * full, "{figures}");
        assert!(ours <= 0.80 * newest && ours <= 0.80 * drawn, "{figures}");
    }
}

#[test]
#[cfg(target_os = "linux")]
#[expect(clippy::disallowed_methods, reason = "the system reports the memory in use")]
#[ignore = "360 000 samples take a minute: \
            cargo test --release -p model --test dictionary -- --ignored --nocapture"]
fn memory_does_not_grow_in_ten_hours() {
    let resident_kib = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap()
    };
    let (mut robot, mut set) = (Robot::new(9), dictionary());
    for _ in 0..5_000 {
        set.insert(robot.step());
    }
    let warm = resident_kib();
    for _ in 0..360_000 {
        set.insert(robot.step());
    }
    let grown = resident_kib().saturating_sub(warm);
    eprintln!("{grown} KiB more after 360 000 samples");
    assert!(grown <= 1_024);
    assert_eq!(set.len(), CAPACITY);
}
