use super::*;
use crate::gp::split_mix::SplitMix64;

const CAPACITY: usize = 30;

fn dictionary(capacity: usize) -> Dictionary<1> {
    Dictionary::new(Selection {
        capacity,
        normalisation: Normalisation::IDENTITY,
        kernel: Hyperparameters::new([1.0], 1.0, 0.01).with_linear(1.0),
        memory_samples: 100.0,
        noise_floor: [1e-3; 3],
    })
}

fn at(x: f64, y: f64) -> Observation<1> {
    Observation { input: [x], target: [y; 3] }
}

/// Samples of a robot at work: mostly near zero, with a sine as residual and noise of 0.01. Returns
/// the outcome of each sample.
fn work(
    set: &mut Dictionary<1>,
    samples: usize,
    sign: f64,
    random: &mut SplitMix64,
) -> Vec<Outcome> {
    let mut step = || {
        let x = 2.0 * random.normal();
        set.insert(at(x, sign * (x.sin() + 1.5) + 0.01 * random.normal()))
    };
    (0..samples).map(|_| step()).collect()
}

/// Largest error of the set's own prediction, over the inputs of the work.
fn error(set: &mut Dictionary<1>, sign: f64) -> f64 {
    let places = (-20..=20).map(|i| 0.1 * f64::from(i));
    places
        .map(|x| {
            set.look_at(&at(x, 0.0));
            let foretold: f64 = set
                .entries
                .iter()
                .zip(&set.solved)
                .map(|(entry, share)| share * entry.observation.target[0])
                .sum();
            (foretold - sign * (x.sin() + 1.5)).abs()
        })
        .fold(0.0, f64::max)
}

#[test]
fn the_updated_inverse_equals_the_recomputed_one() {
    let mut set = dictionary(CAPACITY);
    work(&mut set, 1_000, 1.0, &mut SplitMix64::new(1));
    let mut anew = set.clone();
    let covariance = Mat::from_fn(set.len(), set.len(), |i, j| {
        let (a, b) = (&set.entries[i], &set.entries[j]);
        set.selection.kernel.kernel.value(&a.input, &b.input)
            + if i == j { 0.01 * a.held_scale } else { 0.0 }
    });
    assert!(anew.inverse.recompute(&covariance).is_ok());
    for (kept, new) in set.inverse.diagonal().zip(anew.inverse.diagonal()) {
        assert!((kept - new).abs() < 1e-8 * new, "{kept} is not {new}");
    }
}

#[test]
fn an_excursion_is_kept_through_a_long_steady_stretch() {
    let mut set = dictionary(CAPACITY);
    let mut random = SplitMix64::new(2);
    for place in 0..9 {
        set.insert(at(f64::from(place), 0.1 * f64::from(place)));
    }
    for _ in 0..5_000 {
        set.insert(at(20.0 + 0.1 * random.normal(), 2.0 + 0.01 * random.normal()));
    }
    assert_eq!(set.len(), CAPACITY);
    for place in 0..9 {
        let near = set
            .observations()
            .any(|(observation, _)| (observation.input[0] - f64::from(place)).abs() < 0.75);
        assert!(near, "nothing is left of {place}");
    }
}

#[test]
fn of_two_samples_with_the_same_input_the_older_is_dropped() {
    let mut set = dictionary(3);
    for observation in [at(0.0, 0.0), at(5.0, 0.5), at(5.0, 0.51), at(-5.0, -0.5)] {
        assert_eq!(set.insert(observation), Outcome::Admitted);
    }
    let kept: Vec<f64> = set.observations().map(|(observation, _)| observation.target[0]).collect();
    assert_eq!(kept, [0.0, 0.51, -0.5]);
}

#[test]
fn a_single_outlier_is_never_inserted() {
    let mut set = dictionary(CAPACITY);
    let mut random = SplitMix64::new(3);
    work(&mut set, 200, 1.0, &mut random);
    assert_eq!(set.insert(at(0.3, 50.0)), Outcome::Held);
    work(&mut set, 200, 1.0, &mut random);
    assert!(set.observations().all(|(observation, _)| observation.target[0] < 5.0));
}

#[test]
fn outliers_and_flipped_samples_change_the_prediction_little() {
    for (share, tolerance) in [(0.1, 0.1), (0.3, 0.25)] {
        for seed in 0..5 {
            let mut set = dictionary(CAPACITY);
            let mut random = SplitMix64::new(seed);
            for _ in 0..1_000 {
                let x = 2.0 * random.normal();
                let honest = x.sin() + 1.5 + 0.01 * random.normal();
                let target = match random.uniform() {
                    draw if draw < 0.5 * share => -honest,
                    draw if draw < share => 10.0 * random.normal(),
                    _ => honest,
                };
                set.insert(at(x, target));
            }
            let error = error(&mut set, 1.0);
            assert!(error < tolerance, "{error} with {share} of the samples wild, seed {seed}");
        }
    }
}

#[test]
fn a_sample_stuck_for_long_counts_once() {
    let mut set = dictionary(CAPACITY);
    let mut random = SplitMix64::new(4);
    work(&mut set, 200, 1.0, &mut random);
    let before = set.count;
    for _ in 0..50 {
        set.insert(at(0.5, -3.0));
    }
    assert_eq!(set.count, before + 1);
    assert!(set.observations().all(|(observation, _)| observation.target[0] > -3.0));
}

#[test]
fn a_changed_world_is_soon_accepted_and_learned() {
    let mut set = dictionary(CAPACITY);
    let mut random = SplitMix64::new(5);
    work(&mut set, 500, 1.0, &mut random);
    assert!(error(&mut set, 1.0) < 0.1);
    let outcomes = work(&mut set, 40, -1.0, &mut random);
    assert!(outcomes[..20].contains(&Outcome::Changed), "{outcomes:?}");
    let error = error(&mut set, -1.0);
    assert!(error < 1.0, "{error}, where the change was up to 5");
}

#[test]
fn a_sample_that_is_not_finite_is_never_inserted() {
    let mut set = dictionary(3);
    assert_eq!(set.insert(at(f64::NAN, 0.0)), Outcome::Refused);
    assert_eq!(set.insert(at(0.0, f64::INFINITY)), Outcome::Refused);
    assert!(set.is_empty());
}

#[test]
fn restored_samples_keep_their_age() {
    let mut set = dictionary(CAPACITY);
    work(&mut set, 100, 1.0, &mut SplitMix64::new(6));
    let mut again = dictionary(CAPACITY);
    for (observation, noise_scale) in set.observations() {
        again.restore(*observation, noise_scale);
    }
    for (kept, back) in set.observations().zip(again.observations()) {
        assert_eq!(kept.0, back.0);
        assert!((kept.1 - back.1).abs() < 1e-12);
    }
}

#[test]
fn inserted_samples_can_be_dropped_while_restored_ones_stay() {
    let (mut earlier, mut random) = (dictionary(CAPACITY), SplitMix64::new(8));
    work(&mut earlier, 100, 1.0, &mut random);
    let mut set = dictionary(2 * CAPACITY);
    for (observation, noise_scale) in earlier.observations() {
        set.restore(*observation, noise_scale);
    }
    for step in 0..5 {
        set.insert(at(0.1 * f64::from(step), 9.0));
    }
    set.forget_inserted();
    let restored = earlier.observations().map(|(observation, _)| *observation);
    assert!(set.observations().map(|(observation, _)| *observation).eq(restored));
    // What is left is as good as a set that had nothing else.
    work(&mut set, 50, 1.0, &mut random);
    assert!(error(&mut set, 1.0) < 0.1);
}

#[test]
fn restored_samples_can_be_dropped_while_newer_ones_stay() {
    let (mut earlier, mut random) = (dictionary(CAPACITY), SplitMix64::new(7));
    work(&mut earlier, 100, 1.0, &mut random);
    let mut set = dictionary(CAPACITY);
    for (observation, noise_scale) in earlier.observations() {
        set.restore(*observation, noise_scale);
    }
    let fresh = [at(0.3, -1.8), at(-0.4, -1.1)];
    for observation in fresh {
        set.insert(observation);
    }
    set.forget_restored();
    assert!(set.observations().map(|(observation, _)| *observation).eq(fresh));
    work(&mut set, 200, -1.0, &mut random);
    assert!(error(&mut set, -1.0) < 0.1);
}
