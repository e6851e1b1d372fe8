//! Tests of the gate.

use super::*;
use robot::Robot;

const PERIOD: u64 = 100_000_000;

fn gate() -> Gate {
    let mut robot = Robot::example();
    (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (20.0, 40.0);
    (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (10.0, 20.0);
    Gate::new(Bounds::new(&robot, PERIOD, 0), 7)
}

fn command(epoch: u64, writer: u64, tick: u64) -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.stamp.writer, command.stamp.tick) = (epoch, writer, tick);
    command.plant_epoch = 7;
    command.fallback_level = FallbackLevel::FreshPlan.code();
    command.input = [1.0, 0.0, 0.0];
    command.tail = [[0.9, 0.0, 0.0], [0.8, 0.0, 0.0], [0.7, 0.0, 0.0], [0.0; 3]];
    command.tail_len = 3;
    command
}

#[test]
fn without_a_command_the_wheels_stand_still_and_the_reason_is_waiting() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    let decision = gate.decide(PERIOD / 2);
    assert_eq!((decision.input, decision.fallback_level), ([0.0; 3], FallbackLevel::Waiting));
    assert_eq!(gate.end_period(PERIOD), (FallbackLevel::Waiting, Reason::NoCommandYet));
}

#[test]
fn after_the_last_command_acts_the_tail_and_after_three_periods_the_brake() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&command(1, 5, 0), 10), Ok(()));
    let at = |gate: &mut Gate, periods: f64| gate.decide((periods * PERIOD as f64) as u64);
    assert_eq!(at(&mut gate, 0.5).input[0], 1.0);
    assert_eq!(
        (at(&mut gate, 1.0).input[0], at(&mut gate, 1.0).fallback_level),
        (0.9, FallbackLevel::StoredTail)
    );
    assert_eq!(at(&mut gate, 2.99).input[0], 0.8);
    assert_eq!(at(&mut gate, 3.0).fallback_level, FallbackLevel::Brake);
    let slowing = at(&mut gate, 3.05).input[0];
    assert!(slowing < 0.8 && slowing > 0.0);
    assert_eq!(at(&mut gate, 5.0).input, [0.0; 3]);
}

#[test]
fn each_kind_of_bad_command_is_rejected_with_its_reason() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    gate.begin_period(1, PERIOD);
    gate.begin_period(2, 2 * PERIOD);
    let now = 2 * PERIOD + 10;
    assert_eq!(gate.offer(&command(3, 5, 1), 2 * PERIOD + 10), Ok(()));
    let with = |change: &dyn Fn(&mut Command)| {
        let mut bad = command(3, 5, 2);
        change(&mut bad);
        bad
    };
    for (bad, reason) in [
        (with(&|c| c.input[1] = f64::NAN), Reason::NotFinite),
        (with(&|c| c.tail[2][0] = f64::INFINITY), Reason::NotFinite),
        (with(&|c| c.input[0] = 5.1), Reason::OutOfBounds),
        (with(&|c| c.input = [4.9, 4.9, 5.9]), Reason::OutOfBounds),
        (with(&|c| c.input[0] = -4.9), Reason::TooFast),
        (with(&|c| c.plant_epoch = 6), Reason::OldPlantEpoch),
        (with(&|c| c.stamp.epoch = 2), Reason::OldEpoch),
        (with(&|c| c.stamp.writer = 6), Reason::SecondWriter),
        (with(&|c| c.stamp.tick = 3), Reason::FromTheFuture),
        (with(&|c| c.stamp.tick = 1), Reason::NotNewer),
    ] {
        assert_eq!(gate.offer(&bad, now), Err(reason), "{bad:?}");
    }
    assert_eq!(gate.offer(&command(3, 5, 2), now + 3 * PERIOD / 2), Err(Reason::TooOld));
    assert_eq!(gate.refused(), 11);
    assert_eq!(gate.offer(&command(3, 5, 2), now), Ok(()));
}

#[test]
fn a_second_writer_of_the_same_epoch_is_accepted_once_the_first_is_silent() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
    gate.begin_period(4, 4 * PERIOD);
    assert_eq!(gate.offer(&command(1, 6, 4), 4 * PERIOD), Ok(()));
}

#[test]
fn a_tail_entry_and_a_command_together_keep_the_change_limit_of_one_command() {
    let most = 2.2 * 2.0; // of the rate in a period
    let with = |input: f64, tail: f64, tick| {
        let mut command = command(1, 5, tick);
        (command.input[0], command.tail, command.tail_len) = (input, [[tail, 0.0, 0.0]; 4], 2);
        command
    };
    let mut gate = gate();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&with(1.0, -1.0, 0), 10), Ok(()));
    assert_eq!(gate.decide(PERIOD - 1).input[0], 1.0);
    gate.begin_period(1, PERIOD);
    assert_eq!(gate.decide(PERIOD + 10).input[0], -1.0, "the tail has advanced");
    let too_far = 1.0 - most - 0.1;
    assert!((too_far - -1.0_f64).abs() < most, "relative to the acting input it would be allowed");
    assert_eq!(gate.offer(&with(too_far, too_far, 1), PERIOD + 20), Err(Reason::TooFast));
    assert_eq!(gate.offer(&with(1.0 - most, -3.0, 1), PERIOD + 30), Ok(()));
}

#[test]
fn a_late_command_is_judged_by_the_entry_of_its_tail_that_acts_first() {
    let most = 2.2 * 2.0;
    let late = |tail: f64| {
        let mut command = command(1, 5, 1);
        (command.input[0], command.tail, command.tail_len) = (4.0, [[tail, 0.0, 0.0]; 4], 4);
        command
    };
    let mut gate = gate();
    gate.begin_period(0, 0);
    let mut first = command(1, 5, 0);
    (first.input[0], first.tail) = (0.0, [[0.0; 3]; 4]);
    assert_eq!(gate.offer(&first, 10), Ok(()));
    gate.begin_period(1, PERIOD);
    gate.begin_period(2, 2 * PERIOD);
    assert_eq!(gate.decide(2 * PERIOD).input[0], 0.0);
    let now = 2 * PERIOD + PERIOD / 4;
    assert_eq!(
        gate.offer(&late(most + 0.1), now),
        Err(Reason::TooFast),
        "relative to its input it would be a small step"
    );
    assert_eq!(gate.offer(&late(most - 0.1), now), Ok(()));
    assert_eq!(gate.decide(now).input[0], most - 0.1);
}

#[test]
fn only_an_answer_to_the_present_period_leaves_the_brake() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
    for tick in 1..5 {
        gate.begin_period(tick, tick * PERIOD);
        gate.decide(tick * PERIOD);
        gate.end_period((tick + 1) * PERIOD - 1);
    }
    for tick in 5..8 {
        let now = tick * PERIOD;
        gate.begin_period(tick, now);
        assert_eq!(gate.offer(&command(1, 5, tick), now + 10), Ok(()));
        assert_eq!(gate.decide(now + 20).input, [0.0; 3]);
        assert_eq!(gate.end_period(now + PERIOD - 1), (FallbackLevel::Brake, Reason::Recovering));
    }
    let now = 8 * PERIOD;
    gate.begin_period(8, now);
    assert_eq!(
        gate.decide(now + 5).input,
        [0.0; 3],
        "three good periods are over, and this one has no answer yet"
    );
    assert_eq!(gate.offer(&command(1, 5, 8), now + 10), Ok(()));
    assert_eq!(gate.decide(now + 20).input, [1.0, 0.0, 0.0]);
    assert_eq!(gate.end_period(now + PERIOD - 1), (FallbackLevel::FreshPlan, Reason::None));
}

#[test]
fn a_greater_epoch_takes_over_within_a_period_but_never_with_an_older_answer() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    gate.begin_period(1, PERIOD);
    assert_eq!(gate.offer(&command(1, 5, 1), PERIOD + 10), Ok(()));
    assert_eq!(gate.offer(&command(2, 6, 0), PERIOD + 20), Err(Reason::NotNewer));
    assert_eq!(
        gate.offer(&command(2, 6, 1), PERIOD + 30),
        Ok(()),
        "it is slower, but of a greater epoch"
    );
    assert_eq!(gate.offer(&command(1, 5, 1), PERIOD + 40), Err(Reason::OldEpoch));
    assert_eq!(gate.offer(&command(2, 6, 1), PERIOD + 50), Err(Reason::NotNewer));
}

#[test]
fn leaving_the_brake_needs_three_good_periods() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
    gate.decide(0);
    gate.decide(4 * PERIOD);
    let mut driving = Vec::new();
    for tick in 5..10 {
        gate.begin_period(tick, tick * PERIOD);
        assert_eq!(gate.offer(&command(1, 5, tick), tick * PERIOD + 5), Ok(()));
        driving.push(gate.decide(tick * PERIOD + 10).acting.epoch > 0);
        gate.end_period((tick + 1) * PERIOD);
    }
    assert_eq!(driving, [false, false, false, true, true]);
}

#[test]
fn answers_a_little_into_each_period_keep_their_fallback_level() {
    let mut gate = gate();
    for tick in 0..20 {
        let begin = tick * PERIOD;
        gate.begin_period(tick, begin);
        gate.decide(begin);
        gate.decide(begin + PERIOD / 40);
        let mut simple = command(1, 5, tick);
        simple.fallback_level = FallbackLevel::Simple.code();
        assert_eq!(gate.offer(&simple, begin + PERIOD / 20), Ok(()));
        gate.decide(begin + PERIOD / 2);
        assert_eq!(gate.end_period(begin + PERIOD).0, FallbackLevel::Simple, "tick {tick}");
    }
}

#[test]
fn a_stop_is_latched_against_every_command_until_it_is_resumed() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    let mut asking = command(1, 5, 0);
    asking.stop = Reason::HeadingError.code();
    assert_eq!(gate.offer(&asking, 0), Ok(()));
    assert_eq!(gate.decide(1).fallback_level, FallbackLevel::LatchedStop);
    assert_eq!(gate.end_period(PERIOD), (FallbackLevel::LatchedStop, Reason::HeadingError));
    let period = |gate: &mut Gate, tick: u64| {
        let now = tick * PERIOD;
        gate.begin_period(tick, now);
        gate.decide(now);
        // Another controller has taken over from the one that requested the stop.
        assert_eq!(gate.offer(&command(2, 6, tick), now + 5), Ok(()));
        let input = gate.decide(now + 10).input;
        (input, gate.end_period(now + PERIOD).0)
    };
    for tick in 1..9 {
        assert_eq!(period(&mut gate, tick), ([0.0; 3], FallbackLevel::LatchedStop), "tick {tick}");
    }
    assert_eq!(gate.order(Order::Resume), Ok(()));
    let after: Vec<FallbackLevel> = (9..13).map(|tick| period(&mut gate, tick).1).collect();
    assert_eq!(
        after,
        [
            FallbackLevel::Brake,
            FallbackLevel::Brake,
            FallbackLevel::Brake,
            FallbackLevel::FreshPlan
        ]
    );
    assert_eq!(gate.machine().state(), GateState::Driving);
}

#[test]
fn a_stop_brakes_along_the_ramp() {
    let mut gate = gate();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
    assert_eq!(gate.decide(0).input[0], 1.0);
    gate.stop(Reason::BadState);
    let slowing = gate.decide(PERIOD / 2).input[0];
    assert!((slowing - 0.5).abs() < 1e-12, "10 m/s² for 50 ms from 1 m/s: {slowing}");
    assert_eq!(gate.decide(PERIOD).input, [0.0; 3]);
}

#[test]
fn a_disarmed_gate_drives_once_it_is_armed() {
    let mut gate = gate().disarmed();
    gate.begin_period(0, 0);
    assert_eq!(gate.offer(&command(1, 5, 0), 0), Ok(()));
    assert_eq!(gate.decide(1).input, [0.0; 3]);
    assert_eq!(gate.end_period(PERIOD), (FallbackLevel::Waiting, Reason::Disarmed));
    assert_eq!(gate.order(Order::Arm), Ok(()));
    gate.begin_period(1, PERIOD);
    assert_eq!(gate.offer(&command(1, 5, 1), PERIOD), Ok(()));
    assert_eq!(gate.decide(PERIOD).input[0], 1.0);
    assert_eq!(gate.end_period(2 * PERIOD), (FallbackLevel::FreshPlan, Reason::None));
}
