use super::hypothesis::{DEAD_TIMES, DEAD_TIMES_LONG};
use super::*;
use proptest::prelude::*;
use robot::Robot;

/// The identified response of a robot that follows commands of many frequencies, with noise on
/// its measured velocity.
fn found(periods: f64, truth: [FirstOrder; AXES], noise: f64, count: usize) -> ResponseEstimator {
    found_turning(periods, truth, noise, count, 0.0)
}

/// The same for a robot in which the given share of the turning frame acts.
fn found_turning(
    periods: f64,
    truth: [FirstOrder; AXES],
    noise: f64,
    count: usize,
    kept: f64,
) -> ResponseEstimator {
    found_changing(periods, |_| truth, noise, count, kept)
}

/// The same for a robot whose response may change: `truth` of each period.
fn found_changing(
    periods: f64,
    truth: impl Fn(usize) -> [FirstOrder; AXES],
    noise: f64,
    count: usize,
    kept: f64,
) -> ResponseEstimator {
    found_in(0.02, periods, truth, noise, count, kept)
}

/// The same for another control period \[s\].
fn found_in(
    period_s: f64,
    periods: f64,
    truth: impl Fn(usize) -> [FirstOrder; AXES],
    noise: f64,
    count: usize,
    kept: f64,
) -> ResponseEstimator {
    let main = MainModel::new(&Robot::example(), period_s);
    let delay = Delay::of_periods(periods, &main);
    let (mut sent, mut estimator) =
        (Sent::default(), ResponseEstimator::new(&main, &Robot::example().wheels));
    let mut velocity = [0.0; AXES];
    for k in 0..count {
        sent.push(std::array::from_fn(|axis| {
            (0.31 * (k + 7 * axis) as f64).sin() + 0.2 * (1.3 * k as f64).cos()
        }));
        let acted = sent.acted(delay).input;
        let turning = turning(&main, &velocity).mean;
        velocity = std::array::from_fn(|axis| {
            let FirstOrder { decay, gain, offset } = truth(k)[axis];
            let turned = kept * turning[axis];
            decay * velocity[axis] + gain * acted[axis] + offset + turned
        });
        let measured =
            std::array::from_fn(|axis| velocity[axis] + noise * (12.9 * (k + axis) as f64).sin());
        estimator.update(&sent, &measured, None);
    }
    estimator
}

#[test]
fn an_estimator_continues_from_the_response_of_an_earlier_one() {
    let earlier = found(2.5, soft(0.8), 1e-3, 600);
    let mut later = found(0.0, soft(0.5), 1e-3, 600);
    assert!(later.begin_with(&earlier.found()));
    assert_eq!(later.delay(), earlier.delay());
    assert_eq!(later.response(), earlier.response());
    assert_eq!(later.found(), earlier.found());
}

#[test]
fn a_response_that_is_not_finite_or_of_other_dead_times_is_rejected() {
    let changes: [fn(&mut FoundResponse); 4] = [
        |found| found.hypotheses[3].fits[1].covariance[2][0] = f64::NAN,
        |found| found.hypotheses[3].costs[1] = f64::INFINITY,
        |found| found.believed = DEAD_TIMES.len(),
        |found| _ = found.hypotheses.pop(),
    ];
    for change in changes {
        let mut estimator = found(2.5, soft(0.8), 0.0, 600);
        let mut of = estimator.found();
        change(&mut of);
        let before = estimator.found();
        assert!(!estimator.begin_with(&of));
        assert_eq!(estimator.found(), before);
    }
}

fn soft(decay: f64) -> [FirstOrder; AXES] {
    [FirstOrder { decay, gain: 1.0 - decay, offset: 0.01 }; AXES]
}

proptest! {
    #[test]
    fn dead_time_and_time_constant_are_distinguished(
        which in 0..DEAD_TIMES.len(),
        decay in 0.3..0.95_f64,
    ) {
        let estimator = found(DEAD_TIMES[which], soft(decay), 0.0, 600);
        let delay = estimator.delay().periods();
        prop_assert!((delay - DEAD_TIMES[which]).abs() <= 0.25, "{delay}: {which}");
        for axis in estimator.response().axes {
            prop_assert!((axis.decay - decay).abs() < 0.03, "{axis:?} is not {decay}");
            prop_assert!((axis.gain + decay - 1.0).abs() < 0.03, "{axis:?} is not {decay}");
        }
    }

    #[test]
    fn a_dead_time_between_two_hypotheses_is_found_within_one_step(
        periods in 0.0..6.9_f64,
    ) {
        let step = if periods < 1.5 { 0.25 } else if periods < 3.0 { 0.5 } else { 1.0 };
        let delay = found(periods, soft(0.7), 0.0, 150).delay().periods();
        prop_assert!((delay - periods).abs() < step, "{delay} is not {periods}");
    }

    #[test]
    fn in_a_long_period_the_dead_time_is_found_within_an_eighth_of_it(
        which in 0..DEAD_TIMES_LONG.len(),
        decay in 0.3..0.7_f64,
    ) {
        let (periods, truth) = (DEAD_TIMES_LONG[which], soft(decay));
        let delay = found_in(0.1, periods, |_| truth, 0.0, 300, 0.0).delay().periods();
        let step = if periods < 1.5 { 0.125 } else { 0.5 };
        prop_assert!((delay - periods).abs() <= step, "{delay} is not {periods}");
    }

    #[test]
    fn noise_on_the_velocity_changes_the_response_little(which in 0..DEAD_TIMES.len()) {
        let estimator = found(DEAD_TIMES[which], soft(0.7), 0.01, 500);
        let error = estimator.delay().periods() - DEAD_TIMES[which];
        prop_assert!(error.abs() <= 0.5, "{error}");
    }
}

#[test]
fn the_response_at_standstill_stays_that_of_the_main_model() {
    let main = MainModel::new(&Robot::example(), 0.02);
    let mut estimator = ResponseEstimator::new(&main, &Robot::example().wheels);
    for _ in 0..10_000 {
        estimator.update(&Sent::default(), &[0.0; 3], None);
    }
    assert_eq!(estimator.delay(), Delay::default());
    for (axis, found) in estimator.response().axes.iter().enumerate() {
        assert!((found.decay - main.decay[axis]).abs() < 1e-9, "{found:?}");
        assert!((found.gain - main.gain[axis]).abs() < 1e-9, "{found:?}");
    }
    let at = Moment { velocity: [1.0; 3], input: [1.0; 3], before: [1.0; 3], ..Moment::default() };
    assert!(estimator.response().mean(&at).iter().all(|value| value.abs() < 1e-8));
}

/// The response of the main model.
fn as_believed() -> [FirstOrder; AXES] {
    let main = MainModel::new(&Robot::example(), 0.02);
    std::array::from_fn(|axis| FirstOrder {
        decay: main.decay[axis],
        gain: main.gain[axis],
        offset: 0.0,
    })
}

#[test]
fn the_turning_frame_is_used_for_a_body_of_constant_world_velocity() {
    let response = found_turning(0.0, as_believed(), 0.001, 500, 1.0).response();
    assert!(response.turns);
    for (axis, truth) in response.axes.iter().zip(as_believed()) {
        assert!((axis.decay - truth.decay).abs() < 0.03, "{axis:?} is not {truth:?}");
    }
}

#[test]
fn no_turning_frame_is_used_for_wheels_that_hold_their_speed() {
    assert!(!found_turning(0.0, as_believed(), 0.001, 500, 0.0).response().turns);
}

#[test]
fn numbers_that_are_not_finite_are_ignored() {
    let before = found(2.0, soft(0.8), 0.0, 150);
    let mut after = before.clone();
    after.update(&Sent::always([f64::NAN; 3]), &[0.0; 3], None);
    after.update(&Sent::default(), &[f64::INFINITY; 3], None);
    assert_eq!(after.response(), before.response());
    assert_eq!(after.delay(), before.delay());
}

#[test]
fn the_jacobians_are_the_slopes_of_the_mean() {
    let response = found_turning(0.0, as_believed(), 0.0, 500, 1.0).response();
    assert!(response.turns);
    let at = Moment { velocity: [0.3, -0.2, 0.5], input: [0.1, 0.4, -0.6], ..Moment::default() };
    let slopes = response.response(&at);
    let slope = |change: &dyn Fn(&mut Moment, f64), row: usize| {
        let [up, down] = [1e-4, -1e-4].map(|by| {
            let mut moved = at;
            change(&mut moved, by);
            response.mean(&moved)[row]
        });
        (up - down) / 2e-4
    };
    for row in 0..AXES {
        for column in 0..AXES {
            let by_velocity = slope(&|moved, by| moved.velocity[column] += by, row);
            let by_input = slope(&|moved, by| moved.input[column] += by, row);
            assert!((slopes.by_velocity[row][column] - by_velocity).abs() < 1e-9);
            assert!((slopes.by_input[row][column] - by_input).abs() < 1e-9);
        }
    }
}

/// Largest relative difference of gain and time constant from those of `truth`.
fn differs(estimator: &ResponseEstimator, truth: [FirstOrder; AXES]) -> f64 {
    let axes = estimator.response().axes.into_iter().zip(truth);
    axes.map(|(found, of)| {
        ((found.gain - of.gain) / of.gain)
            .abs()
            .max(((found.decay - of.decay) / (1.0 - of.decay)).abs())
    })
    .fold(0.0, f64::max)
}

#[test]
fn a_change_of_the_robot_is_found_within_three_seconds() {
    let (before, after) = (soft(0.6), soft(0.8));
    let count = 1_000 + 150;
    let estimator =
        found_changing(1.0, |k| if k < 1_000 { before } else { after }, 2e-3, count, 0.0);
    let differs = differs(&estimator, after);
    assert!(differs < 0.1, "{differs}");
}

/// Number of the period in which the dead time of a robot that accelerates slowly, with noise of 5
/// mm/s on its velocity, is known and stays so.
fn known_after(periods: f64, count: usize, with_wheels: bool, slip: f64) -> Option<usize> {
    let main = MainModel::new(&Robot::example(), 0.02);
    let delay = Delay::of_periods(periods, &main);
    let (mut sent, mut estimator) =
        (Sent::default(), ResponseEstimator::new(&main, &Robot::example().wheels));
    let (mut wheels, mut body, mut known) = ([0.0; AXES], [0.0; AXES], None);
    for k in 0..count {
        let start = (0.01 * k as f64).min(0.3);
        sent.push([start + 0.05 * (0.1 * k as f64).sin(), 0.03 * (0.17 * k as f64).sin(), 0.0]);
        let acted = sent.acted(delay).input;
        wheels = std::array::from_fn(|axis| 0.9 * wheels[axis] + 0.1 * acted[axis]);
        // The body of a robot that slides follows its wheels late.
        body = std::array::from_fn(|axis| slip * body[axis] + (1.0 - slip) * wheels[axis]);
        let measured =
            std::array::from_fn(|axis| body[axis] + 0.007 * (12.9 * (k * k + axis) as f64).sin());
        estimator.update(&sent, &measured, with_wheels.then_some(&wheels));
        let is_known = (estimator.delay().periods() - periods).abs() <= 0.5;
        known = if is_known { known.or(Some(k)) } else { None };
    }
    known
}

#[test]
fn wheels_reveal_a_dead_time_that_noise_hides() {
    let with_wheels = known_after(2.5, 1_000, true, 0.0);
    assert!(with_wheels.is_some_and(|period| period < 100), "{with_wheels:?}");
    let without = known_after(2.5, 1_000, false, 0.0);
    assert!(without.is_none_or(|period| period > 300), "{without:?}");
}

#[test]
fn wheels_of_a_robot_without_a_dead_time_propose_none() {
    assert_eq!(known_after(0.0, 1_000, true, 0.0), Some(0));
    assert_eq!(known_after(0.0, 1_000, true, 0.8), Some(0));
}

#[test]
fn wheels_that_stand_still_and_wheels_that_are_not_finite_change_nothing() {
    let main = MainModel::new(&Robot::example(), 0.02);
    for wheels in [[0.0; AXES], [f64::NAN; AXES], [1e300, -1e300, 0.0]] {
        let [mut with, mut without] =
            [(); 2].map(|()| ResponseEstimator::new(&main, &Robot::example().wheels));
        let (mut sent, mut velocity) = (Sent::default(), [0.0; AXES]);
        for k in 0..300 {
            sent.push([(0.3 * f64::from(k)).sin(), 0.0, 0.2]);
            let acted = sent.acted(Delay::of_periods(3.0, &main)).input;
            velocity = std::array::from_fn(|axis| 0.7 * velocity[axis] + 0.3 * acted[axis]);
            with.update(&sent, &velocity, Some(&wheels));
            without.update(&sent, &velocity, None);
            assert_eq!(with.delay(), without.delay(), "{wheels:?}, {k}");
            assert_eq!(with.response(), without.response(), "{wheels:?}, {k}");
        }
    }
}

/// Response of a robot whose wheels follow commands with `truth`, and lose the floor in one of four
/// periods: the body keeps its velocity then.
fn found_on_boards(truth: [FirstOrder; AXES], with_wheels: bool) -> ResponseEstimator {
    let main = MainModel::new(&Robot::example(), 0.02);
    let (mut sent, mut wheels, mut body) = (Sent::default(), [0.0; AXES], [0.0; AXES]);
    let mut estimator = ResponseEstimator::new(&main, &Robot::example().wheels);
    for k in 0..1_000_u32 {
        sent.push(std::array::from_fn(|axis| {
            0.8 * (0.31 * f64::from(k + 7 * axis as u32)).sin() + 0.3 * (1.3 * f64::from(k)).cos()
        }));
        wheels = std::array::from_fn(|axis| {
            let FirstOrder { decay, gain, offset } = truth[axis];
            decay * wheels[axis] + gain * sent.last()[axis] + offset
        });
        if k % 20 >= 5 {
            body = wheels;
        }
        estimator.update(&sent, &body, with_wheels.then_some(&wheels));
    }
    estimator
}

#[test]
fn wheels_that_lose_the_floor_hardly_change_the_response() {
    let truth = soft(0.7);
    let [with, without] =
        [true, false].map(|with_wheels| differs(&found_on_boards(truth, with_wheels), truth));
    assert!(with < 0.15 && without > 1.5 * with, "{with}, {without} without wheels");
}

/// Response of drives that change the rim speeds of their set points by at most `rate` \[m/s²\], to
/// a course with jumps, as on a square. The speed loop of each wheel has the poles `poles`.
fn found_ramped(rate: f64, poles: [f64; 2], periods: f64) -> ResponseEstimator {
    let (main, wheels) = (MainModel::new(&Robot::example(), 0.02), Robot::example().wheels);
    let (delay, mut sent) = (Delay::of_periods(periods, &main), Sent::default());
    let mut estimator = ResponseEstimator::new(&main, &wheels);
    let (mut set_points, mut speeds) = ([0.0; robot::WHEELS_MAX], [[0.0; robot::WHEELS_MAX]; 2]);
    for k in 0..600_u32 {
        let jump = [0.5, -0.5, 0.1, 0.9][k as usize / 40 % 4];
        sent.push([jump, 0.3 * (0.05 * f64::from(k)).sin(), 0.2]);
        let goals = wheels.speeds(sent.acted(delay).input);
        for (wheel, radius) in wheels.radii_m().iter().enumerate() {
            let most = rate * main.period / radius;
            let change = (goals[wheel] - set_points[wheel]).clamp(-most, most);
            set_points[wheel] += change;
            let [first, second] = &mut speeds;
            first[wheel] += (1.0 - poles[0]) * (set_points[wheel] - 0.5 * change - first[wheel]);
            second[wheel] += (1.0 - poles[1]) * (first[wheel] - second[wheel]);
        }
        let body = wheels.body(&speeds[1]);
        let measured =
            std::array::from_fn(|axis| body[axis] + 0.005 * (12.9 * f64::from(k * k)).sin());
        estimator.update(&sent, &measured, Some(&body));
    }
    estimator
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_ramp_of_a_drive_is_found(rate in 0.7..4.0_f64, pole in 0.3..0.8_f64, late in 0..3_u32) {
        let estimator = found_ramped(rate, [pole, 0.0], f64::from(late));
        let found = estimator.ramp_mps2().ok_or_else(|| TestCaseError::fail("no ramp"))?;
        prop_assert!((found / rate - 1.0).abs() < 0.2, "{found} is not {rate}");
    }

    #[test]
    fn two_lags_and_a_dead_time_are_no_ramp(
        first in 0.3..0.97_f64,
        second in 0.0..0.8_f64,
        late in 0..6_u32,
    ) {
        let estimator = found_ramped(f64::INFINITY, [first, second], f64::from(late));
        prop_assert_eq!(estimator.ramp_mps2(), None);
    }
}

#[test]
fn an_estimator_continues_with_the_ramp_of_an_earlier_one() {
    let earlier = found_ramped(2.0, [0.6, 0.0], 1.0);
    let mut later = found_ramped(f64::INFINITY, [0.6, 0.0], 0.0);
    assert!(later.begin_with(&earlier.found()));
    assert_eq!(later.ramp_mps2(), earlier.ramp_mps2());
    assert_eq!(later.found(), earlier.found());
    for impossible in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let found = FoundResponse { ramp_mps2: Some(impossible), ..earlier.found() };
        assert!(!later.begin_with(&found), "{impossible}");
    }
}
