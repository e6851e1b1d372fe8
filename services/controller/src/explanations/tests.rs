use super::*;
use model::delay::Sent;
use model::gp::posterior::VarianceScratch;
use model::learned::{Response, Uncertain};
use model::response::ResponseEstimator;
use robot::Robot;

const PERIOD: f64 = 0.02;

fn main() -> MainModel {
    MainModel::new(&Robot::example(), PERIOD)
}

fn explanations(choice: Choice) -> Explanations {
    let response = ResponseEstimator::new(&main(), &Robot::example().wheels).response();
    let physics = Physics::new(&main(), &Robot::example().wheels);
    Explanations::new(choice, &main(), [1.0; AXES], response, physics)
}

const WITH_OBSERVERS: Choice = Choice {
    observer_gain: 1.0,
    observers: Observers::Gains,
    identify: Identify::Off,
    blind: false,
};

/// Pseudo-random and repeatable, of mean square 1.
fn noise(k: usize) -> f64 {
    let wave = (12.9898 * k as f64).sin() * 43758.5453;
    (wave - wave.floor() - 0.5) * 12.0_f64.sqrt()
}

/// The explanations after `count` periods whose residual is `of(k)` on every axis.
fn after(choice: Choice, count: usize, of: impl Fn(usize) -> f64) -> Explanations {
    let mut explanations = explanations(choice);
    let response = explanations.response;
    for k in 0..count {
        explanations.update(&Moment::default(), &[of(k); AXES], &[0.0; AXES], response, 0);
    }
    explanations
}

fn used_gains(explanations: &Explanations) -> [f64; AXES] {
    explanations.axes.map(|axis| GAINS[observer(axis.chosen)])
}

#[test]
fn a_constant_disturbance_is_found() {
    for (found, bound) in
        after(WITH_OBSERVERS, 200, |_| 0.1).disturbance().into_iter().zip([1.0; 3])
    {
        assert!((found - 0.1).abs() < 1e-9 * bound);
    }
}

/// Noise of a measured velocity enters two residuals, with opposite signs.
#[test]
fn velocity_noise_is_filtered() {
    let decay = main().decay[0];
    let observed = after(WITH_OBSERVERS, 2000, |k| 0.01 * (noise(k + 1) - decay * noise(k)));
    for (gain, found) in used_gains(&observed).into_iter().zip(observed.disturbance()) {
        assert!(gain <= 0.5, "a gain of {gain}");
        assert!(found.abs() < 0.005, "{found}");
    }
}

#[test]
fn a_disturbance_that_changes_quickly_is_followed_by_a_large_gain() {
    let observed = after(WITH_OBSERVERS, 2000, |k| 0.1 * (0.05 * k as f64).sin() + 1e-4 * noise(k));
    for gain in used_gains(&observed) {
        assert!(gain >= 0.5, "a gain of {gain}");
    }
}

#[test]
fn a_sudden_disturbance_is_compensated_within_half_a_second() {
    let push = |k| if k < 1000 { 0.0 } else { 0.1 };
    let observed = after(WITH_OBSERVERS, 1025, |k| push(k) + 0.01 * noise(k));
    for found in observed.disturbance() {
        assert!((found - 0.1).abs() < 0.03, "{found}");
    }
}

#[test]
fn without_a_gain_there_is_no_disturbance() {
    let choice = Choice { observer_gain: 0.0, ..WITH_OBSERVERS };
    assert_eq!(after(choice, 100, |_| 0.1).disturbance(), [0.0; AXES]);
}

#[test]
fn one_absurd_sample_moves_the_disturbance_no_further_than_physics_allow() {
    let observed = after(WITH_OBSERVERS, 1, |_| 1000.0);
    assert_eq!(observed.disturbance(), [1.0; AXES]);
    let nonsense = after(WITH_OBSERVERS, 3, |k| if k == 1 { f64::NAN } else { 0.1 });
    assert!(nonsense.disturbance().iter().all(|value| value.is_finite()));
}

#[test]
fn a_robot_with_another_response_is_predicted_by_its_response() {
    let choice = Choice { identify: Identify::Response, ..WITH_OBSERVERS };
    let mut explanations = explanations(choice);
    let mut estimator = ResponseEstimator::new(&main(), &Robot::example().wheels);
    let (mut sent, mut velocity) = (Sent::default(), [0.0; AXES]);
    estimator.resume(&[0.0; AXES], &velocity, None);
    for k in 0..500 {
        // A soft speed loop forward; the other axes match the main model.
        let input: Velocity = std::array::from_fn(|axis| (0.2 * (k + axis) as f64).sin());
        sent.push(input);
        let mut next = main().next_velocity(&velocity, &input);
        next[0] = 0.95 * velocity[0] + 0.05 * input[0];
        let residual = model::residual::residual(&main(), &velocity, &input, &next);
        let at = Moment { velocity, input, before: input, ..Moment::default() };
        estimator.update(&sent, &next, None);
        explanations.update(&at, &residual, &[0.0; AXES], estimator.response(), 0);
        velocity = next;
    }
    assert_eq!(explanations.models()[0], Model::Response);
    let at = Moment { velocity: [0.5; 3], input: [0.1; 3], ..Moment::default() };
    let expected = 0.95 * 0.5 + 0.05 * 0.1 - main().next_velocity(&[0.5; 3], &[0.1; 3])[0];
    assert!((explanations.mean(&at)[0] - expected).abs() < 1e-3);
}

/// A learned model with a constant residual.
#[derive(Debug)]
struct Constant(f64);

impl Residual for Constant {
    fn mean(&self, _: &Moment) -> Velocity {
        [self.0; AXES]
    }

    fn response(&self, at: &Moment) -> Response {
        Response { mean: self.mean(at), ..Response::NONE }
    }
}

impl Uncertain for Constant {
    fn variance(&self, _: &Moment, _: &mut VarianceScratch) -> Velocity {
        [self.0; AXES]
    }

    fn sample_variance(&self, at: &Moment, scratch: &mut VarianceScratch) -> Velocity {
        self.variance(at, scratch)
    }
}

fn candidate(version: u64, value: f64) -> Candidate {
    Candidate {
        version,
        plant_epoch: 1,
        effective_tick: 0,
        learned: Box::new(Constant(value)),
        scratch: VarianceScratch::new(0),
    }
}

/// Versions in use and versions returned, while models with these residuals arrive every 10 s.
/// The true residual is 0.1.
fn versions(value: &[f64]) -> Vec<(u64, Option<u64>)> {
    let mut explanations = explanations(Choice { observer_gain: 0.0, ..WITH_OBSERVERS });
    let response = explanations.response;
    let mut adopt = |(version, &value): (usize, &f64)| {
        let back = explanations.adopt(Box::new(candidate(1 + version as u64, value)));
        for _ in 0..500 {
            let residual = [0.1; AXES];
            explanations.update(&Moment::default(), &residual, &[0.0; AXES], response, 0);
        }
        let at = Moment::default();
        assert_eq!(explanations.variance(&at), explanations.mean(&at));
        (explanations.version(), back.map(|back| back.version))
    };
    value.iter().enumerate().map(&mut adopt).collect()
}

#[test]
fn a_model_that_was_in_use_for_a_moment_is_not_the_last_good_one() {
    let mut explanations = explanations(Choice { observer_gain: 0.0, ..WITH_OBSERVERS });
    let response = explanations.response;
    let mut drive = |version, value, periods| {
        let back = explanations.adopt(Box::new(candidate(version, value)));
        for _ in 0..periods {
            let residual = [0.1; AXES];
            explanations.update(&Moment::default(), &residual, &[0.0; AXES], response, 0);
        }
        back.map(|back| back.version)
    };
    assert_eq!(drive(1, 0.1, 500), None);
    assert_eq!(drive(2, -0.5, 2), None);
    // The second model is returned, and the first one stays.
    assert_eq!(drive(3, -0.5, 500), Some(2));
    assert_eq!(explanations.version(), 1);
}

#[test]
fn an_abandoned_model_is_replaced_by_the_last_good_one() {
    // A better model, three that are worse than none, and the best one.
    let versions = versions(&[0.08, 0.09, -0.5, -0.6, -0.2, 0.1, 0.1]);
    let (first, second) = ([(1, None), (2, None)], [(2, Some(1)), (2, Some(3)), (2, Some(4))]);
    let expected = [&first[..], &second, &[(6, Some(5)), (7, Some(2))]].concat();
    assert_eq!(versions, expected);
}
