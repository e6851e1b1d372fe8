use super::*;

const PERIOD_S: f64 = 0.02;

/// The complaints after 5 s of states `of(tick)`. Each appears once per start.
fn told(of: impl Fn(u64) -> PlantState) -> Vec<Complaint> {
    with_limits(of, &LimitsInUse::default())
}

/// The same, with plans that say this of the limits.
fn with_limits(of: impl Fn(u64) -> PlantState, limits: &LimitsInUse) -> Vec<Complaint> {
    let mut complaints = complaints(Pace::LockStep);
    (0..250).filter_map(|tick| complaints.look(&of(tick), limits)).collect()
}

fn complaints(pace: Pace) -> Complaints {
    Complaints::new(&Robot::example(), PERIOD_S, pace)
}

/// A circle, driven with a true period of `period` \[s\].
fn circle(tick: u64, period: f64) -> PlantState {
    let mut state: PlantState = bytemuck::Zeroable::zeroed();
    let angle = 0.5 * period * tick as f64;
    (state.stamp.epoch, state.stamp.tick) = (1, tick);
    state.pose = [2.0 * angle.sin(), 2.0 - 2.0 * angle.cos(), angle];
    state.velocity = [1.0, 0.0, 0.5];
    state.input = state.velocity;
    state
}

#[test]
fn a_driver_without_errors_has_no_complaints() {
    assert_eq!(told(|tick| circle(tick, PERIOD_S)), []);
    // The same for a robot at rest with noise.
    assert_eq!(
        told(|tick| {
            let mut state = circle(0, PERIOD_S);
            state.pose[0] = 1e-3 * (13.0 * tick as f64).sin();
            state.velocity = [1e-2 * (17.0 * tick as f64).sin(), 0.0, 0.0];
            state
        }),
        []
    );
}

#[test]
fn a_driver_with_another_period_is_reported_once_with_the_ratio() {
    for (period, expected) in [(0.1, 5.0), (0.01, 0.5)] {
        let complaints = told(|tick| circle(tick, period));
        assert_eq!(complaints.len(), 1, "{complaints:?}");
        let is_told = |complaint: &Complaint| {
            matches!(complaint, Complaint::Period { ratio, .. }
                if (ratio - expected).abs() < 0.05 * expected)
        };
        assert!(complaints.iter().all(is_told), "{complaints:?}");
    }
}

#[test]
fn commands_that_are_refused_repeatedly_are_reported_with_the_reason() {
    let storm = |tick| PlantState {
        refused: tick,
        reason: Reason::OutOfBounds.code(),
        ..circle(tick, PERIOD_S)
    };
    let complaints = told(storm);
    assert_eq!(complaints.len(), 1, "{complaints:?}");
    assert!(
        matches!(complaints[0], Complaint::Refusals { reason: Reason::OutOfBounds, .. }),
        "{complaints:?}"
    );
    // A few refusals are no complaint.
    assert_eq!(told(|tick| PlantState { refused: tick / 10, ..circle(tick, PERIOD_S) }), []);
}

#[test]
fn a_motor_that_stays_at_its_limit_is_reported() {
    let limit = Robot::example().current_limit_a().unwrap_or_default();
    let complaints = told(|tick| PlantState {
        current: [0.0, -limit, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        wheels: 4,
        current_valid: 1,
        ..circle(tick, PERIOD_S)
    });
    assert!(matches!(complaints[..], [Complaint::Current { .. }]), "{complaints:?}");
}

#[test]
fn a_robot_that_does_not_move_as_commanded_is_reported() {
    let complaints = told(|tick| PlantState {
        velocity: [0.01, 0.0, 0.0],
        pose: [1e-4 * tick as f64, 0.0, 0.0],
        ..circle(tick, PERIOD_S)
    });
    assert!(
        matches!(complaints[..], [Complaint::NoEffect { share }] if share < 0.02),
        "{complaints:?}"
    );
}

#[test]
fn a_robot_that_follows_late_is_not_reported() {
    // Steps of 1 m/s to either side for half a second each, and a dead time of 0.4 s.
    let step = |tick: u64| if (tick / 25).is_multiple_of(2) { 1.0 } else { -1.0 };
    let late = |tick: u64| PlantState {
        input: [step(tick), 0.0, 0.0],
        velocity: [step(tick.saturating_sub(20)), 0.0, 0.0],
        pose: [0.0; 3],
        ..circle(tick, PERIOD_S)
    };
    let effects = |complaints: Vec<Complaint>| {
        complaints.into_iter().filter(|it| matches!(it, Complaint::NoEffect { .. })).count()
    };
    assert_eq!(effects(told(late)), 0);
    // A start after a standstill.
    let starts = |tick: u64| PlantState {
        input: [if tick < 100 { 0.0 } else { 5.0 }, 0.0, 0.0],
        velocity: [if tick < 115 { 0.0 } else { 5.0 }, 0.0, 0.0],
        ..circle(tick, PERIOD_S)
    };
    assert_eq!(effects(told(starts)), 0);
}

#[test]
fn periods_of_the_simple_controller_are_reported() {
    let fallback_level =
        |tick| if tick % 5 == 0 { FallbackLevel::Simple } else { FallbackLevel::FreshPlan };
    let complaints = told(|tick| PlantState {
        fallback_level: fallback_level(tick).code(),
        ..circle(tick, PERIOD_S)
    });
    assert!(matches!(complaints[..], [Complaint::Simple { .. }]), "{complaints:?}");
}

#[test]
fn a_robot_that_is_slow_because_its_list_of_obstacles_is_too_old_is_reported() {
    let slowed_by = |reason: Reason| {
        told(|tick| PlantState { reason: reason.code(), ..circle(tick, PERIOD_S) })
    };
    let complaints = slowed_by(Reason::ObstaclesUnknown);
    assert!(matches!(complaints[..], [Complaint::NoList { .. }]), "{complaints:?}");
    assert_eq!(slowed_by(Reason::ProtectiveStop), []);
}

#[test]
fn a_limit_that_its_motor_contradicts_is_reported_once() {
    let wheels = std::array::from_fn(|wheel| [1, 2].contains(&wheel));
    let contradicted = Some(Contradicted { wheels, carried: 0.4 });
    let limits = LimitsInUse { contradicted, ..LimitsInUse::default() };
    let reported = with_limits(|tick| circle(tick, PERIOD_S), &limits);
    assert_eq!(reported, [Complaint::Row { wheels, carried: 0.4 }]);
    assert!(reported[0].to_string().contains("motor 2, 3:"), "{}", reported[0]);
}

#[test]
fn plans_that_reach_a_limit_for_seconds_are_reported() {
    let reached = Some(RobotLimit::MotorCurrent);
    let limits = LimitsInUse { reached, ..LimitsInUse::default() };
    let by_plan = |tick| PlantState {
        fallback_level: FallbackLevel::FreshPlan.code(),
        ..circle(tick, PERIOD_S)
    };
    let reported = with_limits(by_plan, &limits);
    let is_limit = |complaint: &Complaint| {
        matches!(complaint, Complaint::Limit { share, limit: RobotLimit::MotorCurrent }
            if *share > 0.99)
    };
    assert!(reported.len() == 1 && reported.iter().all(is_limit), "{reported:?}");
    // Once, although a plan in between reaches none.
    let mut often = complaints(Pace::LockStep);
    let with = |tick: u64| if tick.is_multiple_of(10) { LimitsInUse::default() } else { limits };
    let reported: Vec<_> = (0..500).filter_map(|k| often.look(&by_plan(k), &with(k))).collect();
    assert!(matches!(reported[..], [Complaint::Limit { .. }]), "{reported:?}");
    // Not while the robot approaches its reference, nor if another than the plan drives.
    let mut complaints = complaints(Pace::LockStep);
    let soon: Vec<_> = (0..200).filter_map(|k| complaints.look(&by_plan(k), &limits)).collect();
    assert_eq!(soon, []);
    assert_eq!(with_limits(|tick| circle(tick, PERIOD_S), &limits), []);
}

#[test]
fn states_at_another_rate_are_reported_at_rest_too_but_not_in_lock_step() {
    let every = |nanos: u64, pace: Pace| {
        let mut complaints = complaints(pace);
        let states = (0..250).map(|tick| {
            let mut state = circle(0, PERIOD_S);
            (state.stamp.tick, state.stamp.sent_nanos) = (tick, 1_000_000_000 + tick * nanos);
            (state.velocity, state.input) = ([0.0; 3], [0.0; 3]);
            state
        });
        let limits = LimitsInUse::default();
        states.filter_map(|state| complaints.look(&state, &limits)).collect::<Vec<_>>()
    };
    let reported = every(100_000_000, Pace::RealTime);
    let is_told = matches!(reported[..],
        [Complaint::Rate { interval_s, .. }] if (interval_s - 0.1).abs() < 1e-9);
    assert!(is_told, "{reported:?}");
    assert_eq!(every(20_000_000, Pace::RealTime), []);
    assert_eq!(every(100_000, Pace::LockStep), []);
}

#[test]
fn a_driver_that_stalls_once_has_no_other_rate() {
    let mut complaints = complaints(Pace::RealTime);
    let states = (0..400).map(|tick| {
        let mut state = circle(tick, PERIOD_S);
        let stalled = if tick < 200 { 0 } else { 5_000_000_000 };
        state.stamp.sent_nanos = 1_000_000_000 + tick * 20_000_000 + stalled;
        state
    });
    let limits = LimitsInUse::default();
    let reported: Vec<_> = states.filter_map(|state| complaints.look(&state, &limits)).collect();
    assert_eq!(reported, []);
}

#[test]
fn two_simultaneous_errors_are_each_reported_once() {
    let both = |tick| PlantState { refused: tick, ..circle(tick, 5.0 * PERIOD_S) };
    let reported = told(both);
    assert!(
        matches!(reported[..], [Complaint::Refusals { .. }, Complaint::Period { .. }]),
        "{reported:?}"
    );
}

#[test]
fn a_state_that_is_not_finite_does_not_hide_a_later_complaint() {
    let broken = |tick| {
        let mut state = circle(tick, 5.0 * PERIOD_S);
        if tick == 3 {
            state.velocity[0] = f64::NAN;
        }
        state
    };
    assert!(matches!(told(broken)[..], [Complaint::Period { .. }]));
}

#[test]
fn every_sentence_fits_into_a_health() {
    for complaint in [
        Complaint::Refusals { share: 1.0, reason: Reason::OutOfBounds },
        Complaint::Period { ratio: -1234.5678, period_s: 0.1 },
        Complaint::Rate { interval_s: 123.456, period_s: 0.1 },
        Complaint::Limit { share: 1.0, limit: RobotLimit::Input },
        Complaint::Current { share: 1.0, limit_a: 123.456 },
        Complaint::Row { wheels: [true; WHEELS_MAX], carried: 0.5 },
        Complaint::NoEffect { share: -1.0 },
        Complaint::Simple { share: 1.0 },
        Complaint::NoList { share: 1.0 },
    ] {
        assert_eq!(Sentence::of(&complaint).text(), complaint.to_string());
    }
}
