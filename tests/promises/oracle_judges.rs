//! Promise: the oracle finds no violation in a good run, and in a bad one exactly the injected
//! violations.

use experiment::in_process;
use graph::assembly::Assembly;
use graph::options::Options;
use graph::scenario::Scenario;
use promises::oracle::{Limits, Rule, judge};
use promises::tracking::{self, Course, Twin, Windows, largest_error};
use promises::{Message, Outcome, Record, repository};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;

/// Ten seconds of the paper's scenario in lock step.
fn good_run() -> Result<(Record, Limits), Box<dyn Error>> {
    // Tight enough that a change can be too fast within the wheels' speed.
    let mut assembly = assembly()?;
    assembly.robot.limits.input_rate_mps2 = 20.0;
    assembly.scenario.duration_s = 10.0;
    Ok((run(&assembly)?, Limits::of(&assembly)))
}

pub(crate) fn assembly() -> Result<Assembly, Box<dyn Error>> {
    Ok(Assembly::read(&Options::of_graph(&repository().join("deploy/graphs/local.toml")))?)
}

fn run(assembly: &Assembly) -> Result<Record, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let run = folder.path().join("run");
    fs::create_dir(&run)?;
    in_process::run(assembly, &run)?;
    Ok(Record::read(&run)?)
}

/// Ten seconds of the scenario of the drill, in lock step.
fn good_eight() -> Result<(Record, Limits, Course), Box<dyn Error>> {
    let mut assembly = assembly()?;
    let scenarios = repository().join("deploy/scenarios");
    assembly.scenario = Scenario::named(&scenarios, "figure-eight", Some("agile"), &[])?;
    assembly.scenario.duration_s = 10.0;
    let (record, limits) = (run(&assembly)?, Limits::of(&assembly));
    let course = Course::of(&assembly, Twin::default());
    let fresh_m = largest_error(&record, &limits, &course)?;
    let course = course.with(Twin { fresh_m, ..Twin::default() });
    Ok((record, limits, course))
}

/// The record in which the tail of the answer to tick 49 acted in the period that began with tick
/// 50, as it was sent, or as `change` changes it.
fn bridged(record: &Record, change: impl Fn(&mut Value)) -> Vec<Message> {
    let mut messages = record.messages().to_vec();
    let answer = messages
        .iter()
        .find(|message| message.topic == "truth" && message.stamp("tick") == 50)
        .map(|message| message.fields.clone());
    for message in &mut messages {
        match (message.topic.as_str(), message.stamp("tick")) {
            // The wheels keep their previous speed, so that must be the tail.
            ("command", 49) => {
                message.fields["tail"][0] = message.fields["input"].clone();
                change(&mut message.fields["tail"][0]);
            }
            ("truth", 51) => {
                for field in ["wheel_command", "acting_tick"] {
                    message.fields[field] =
                        answer.as_ref().map_or(Value::Null, |truth| truth[field].clone());
                }
                (message.fields["fallback_level"], message.fields["reason"]) =
                    (json!("stored tail"), json!("command missing"));
            }
            _ => {}
        }
    }
    messages
}

/// The rules that `record` violates after `change` was applied to the messages of `topic` at
/// `tick`.
fn violated(
    record: &Record,
    limits: &Limits,
    (topic, tick): (&str, u64),
    change: impl Fn(&mut Value),
) -> BTreeSet<Rule> {
    let mut messages = record.messages().to_vec();
    for message in messages
        .iter_mut()
        .filter(|message| message.topic == topic && message.stamp("tick") == tick)
    {
        change(&mut message.fields);
    }
    judge(&Record::of_messages(messages), limits).iter().map(|violation| violation.rule).collect()
}

/// The record with the plant's messages changed as if it had braked by itself from straight motion,
/// between tick 50 and `until`. Commands are accepted again from `answered_from` on.
fn braked(record: &Record, limits: &Limits, until: u64, answered_from: u64) -> Vec<Message> {
    let mut messages = record.messages().to_vec();
    let mut body = messages
        .iter()
        .find(|message| message.topic == "truth" && message.stamp("tick") == 49)
        .map_or([0.0; 3], |truth| body_of(&truth.numbers("wheel_command"), limits));
    for message in &mut messages {
        let tick = message.stamp("tick");
        if !matches!(message.topic.as_str(), "state" | "truth") || !(50..until).contains(&tick) {
            continue;
        }
        message.fields["fallback_level"] = json!("brake");
        message.fields["reason"] = json!("command missing");
        if message.topic == "state" && tick < answered_from {
            message.fields["accepted_tick"] = json!(48);
        }
        if message.topic == "truth" {
            for (value, brake) in body.iter_mut().zip(limits.brake) {
                let ramp = brake * limits.period_s;
                *value -= value.clamp(-ramp, ramp);
            }
            message.fields["wheel_command"] = json!(wheels_of(body, limits));
            for field in ["acting_epoch", "acting_tick", "acting_age_nanos"] {
                message.fields[field] = json!(0);
            }
        }
    }
    messages
}

/// Wheel speeds of a body velocity.
fn wheels_of(velocity: [f64; 3], limits: &Limits) -> Vec<f64> {
    limits.wheels.speeds(velocity)[..limits.wheels.count()].to_vec()
}

/// The inverse.
fn body_of(wheels: &[f64], limits: &Limits) -> [f64; 3] {
    limits.wheels.body(&std::array::from_fn(|wheel| wheels.get(wheel).copied().unwrap_or(0.0)))
}

fn rules(messages: Vec<Message>, limits: &Limits) -> Vec<Rule> {
    judge(&Record::of_messages(messages), limits).iter().map(|violation| violation.rule).collect()
}

#[test]
fn a_good_run_has_no_violation_and_each_bad_one_exactly_its_own() -> Outcome {
    let (record, limits) = good_run()?;
    assert_eq!(judge(&record, &limits), []);
    assert_eq!(record.of("truth").count(), 101);
    let found = |at, change: &dyn Fn(&mut Value)| {
        violated(&record, &limits, at, change).into_iter().collect::<Vec<Rule>>()
    };

    assert_eq!(found(("truth", 60), &|truth| truth["wheel_peak"][2] = Value::Null), [Rule::Finite]);
    assert_eq!(
        found(("truth", 60), &|truth| truth["wheel_command"][0] = Value::Null),
        [Rule::Finite]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["wheel_peak"][1] = json!(120.1)),
        [Rule::Bounds]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["wheel_command"] = json!(vec![-60.0; 4])),
        [Rule::Rate, Rule::Leap, Rule::AsCommanded]
    );
    let another = |truth: &mut Value| {
        truth["wheel_command"][0] =
            json!(truth["wheel_command"][0].as_f64().unwrap_or(0.0) + 0.001);
    };
    assert_eq!(found(("truth", 60), &another), [Rule::AsCommanded]);
    assert_eq!(
        found(("command", 59), &|command| command["input"] = json!([0.0, 0.0, 0.0])),
        [Rule::AsCommanded]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["acting_age_nanos"] = json!(301_000_000)),
        [Rule::Age]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["acting_tick"] = json!(56)),
        [Rule::Age, Rule::AsCommanded]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["acting_writer"] = json!(5)),
        [Rule::Epoch],
        "two writers of one epoch"
    );
    let late = |state: &mut Value| state["accepted_tick"] = json!(57);
    assert_eq!(found(("state", 60), &late), [Rule::Age], "of a state 2 T old");
    assert_eq!(found(("truth", 60), &|truth| truth["acting_tick"] = json!(61)), [Rule::Age]);
    assert_eq!(found(("truth", 60), &|truth| truth["takeovers"] = json!(2)), [Rule::Epoch]);
    assert_eq!(found(("truth", 60), &|truth| truth["takeovers_back"] = json!(1)), [Rule::Epoch]);
    assert_eq!(
        found(("truth", 60), &|truth| truth["takeovers"] = json!(1)),
        [],
        "a successor has taken over"
    );
    let successor = |truth: &mut Value| {
        truth["acting_epoch"] = json!(truth["acting_epoch"].as_u64().unwrap_or(0) + 1);
    };
    assert_eq!(found(("truth", 60), &successor), [Rule::Epoch], "and the one before it acts again");
    assert_eq!(
        found(("state", 60), &|state| state["fallback_level"] = json!("simple controller")),
        [Rule::Reason]
    );
    assert_eq!(
        found(("state", 60), &|state| (state["fallback_level"], state["reason"]) =
            (json!("simple controller"), json!("no plan that holds"))),
        []
    );
    assert_eq!(
        found(("command", 60), &|command| command["stamp"]["sequence"] = json!(9)),
        [Rule::Count],
        "one is missing"
    );
    Ok(())
}

#[test]
fn a_brake_is_a_ramp_to_rest_that_is_left_after_three_good_periods() -> Outcome {
    let (record, limits) = good_run()?;
    assert_eq!(rules(braked(&record, &limits, 60, 57), &limits), []);
    assert_eq!(rules(braked(&record, &limits, 60, 59), &limits), [Rule::Recovery]);
    let mut stopped = braked(&record, &limits, 60, 59);
    for message in
        stopped.iter_mut().filter(|message| message.topic == "state" && message.stamp("tick") == 60)
    {
        message.fields["fallback_level"] = json!("latched stop");
        message.fields["reason"] = json!("operator stop");
    }
    assert_eq!(rules(stopped, &limits), [], "a latched stop keeps the brake");
    let mut messages = braked(&record, &limits, 60, 57);
    for message in messages
        .iter_mut()
        .filter(|message| message.topic == "truth" && message.stamp("tick") == 51)
    {
        message.fields["wheel_command"] = json!(vec![54.0; 4]);
    }
    assert!(rules(messages, &limits).contains(&Rule::Ramp));
    Ok(())
}

#[test]
fn a_gap_is_bridged_by_the_tail_that_was_sent() -> Outcome {
    let (record, limits) = good_run()?;
    assert_eq!(rules(bridged(&record, |_| ()), &limits), []);
    assert_eq!(
        rules(bridged(&record, |entry| entry[0] = json!(0.5)), &limits),
        [Rule::AsCommanded]
    );
    Ok(())
}

#[test]
fn the_wheels_do_not_leap_into_the_brake_nor_out_of_it() -> Outcome {
    let (record, limits) = good_run()?;
    let at = |tick: u64, wheels: f64, acted_nanos: u64| {
        let mut messages = braked(&record, &limits, 60, 57);
        for message in messages
            .iter_mut()
            .filter(|message| message.topic == "truth" && message.stamp("tick") == tick)
        {
            message.fields["wheel_command"] = json!(vec![wheels; 4]);
            if acted_nanos > 0 {
                message.fields["acting_age_nanos"] = json!(acted_nanos);
            }
        }
        rules(messages, &limits)
    };
    let most = limits.rate[0] * limits.period_s / limits.wheels.radius_m();
    let first = 54.0 - limits.brake[0] * limits.period_s / limits.wheels.radius_m();
    let stepped = first - 0.5 * most;
    assert!(at(50, stepped, 0).contains(&Rule::Rate), "faster than the ramp");
    assert!(!at(50, stepped, 1).contains(&Rule::Rate), "a step of the tail, then the ramp");
    assert!(at(50, -100.0, 0).contains(&Rule::Rate), "a leap into the brake");
    assert!(at(50, -100.0, 1).contains(&Rule::Rate), "a leap into the brake from a command");
    assert!(at(60, -100.0, 0).contains(&Rule::Rate), "a leap out of it");
    Ok(())
}

#[test]
fn a_change_of_the_wheels_beyond_the_robot_file_is_found_at_20_and_at_100_ms() -> Outcome {
    let mut paper = assembly()?;
    paper.scenario.duration_s = 10.0;
    let slow = (run(&paper)?, Limits::of(&paper));
    let (record, limits, _) = good_eight()?;
    for ((record, limits), most) in [(slow, 6.0), ((record, limits), 1.2)] {
        assert!((limits.rate[0] * limits.period_s - most).abs() < 1e-9, "{limits:?}");
        assert_eq!(judge(&record, &limits), []);
        let moved_by = |step: f64| {
            violated(&record, &limits, ("truth", 60), |truth| {
                let wheels = truth["wheel_command"].as_array().cloned().unwrap_or_default();
                let wheels: Vec<f64> = wheels.iter().filter_map(Value::as_f64).collect();
                let [forward, left, yaw] = body_of(&wheels, &limits);
                truth["wheel_command"] = json!(wheels_of([forward - step, left, yaw], &limits));
            })
        };
        let slack = 0.2 * most; // far more than an input changes in a period of these scenarios
        assert!(moved_by(most + slack).contains(&Rule::Rate), "{most} m/s in a period");
        assert!(
            !moved_by(most + slack).contains(&Rule::Leap),
            "the gate's rule alone lets it pass"
        );
        assert!(!moved_by(most - slack).contains(&Rule::Rate));
    }
    Ok(())
}

#[test]
fn a_wheel_that_turns_against_the_others_is_found_although_the_body_command_is_lawful() -> Outcome {
    let (record, limits, _) = good_eight()?;
    let found = violated(&record, &limits, ("truth", 60), |truth| {
        truth["wheel_command"][2] = json!(truth["wheel_command"][2].as_f64().unwrap_or(0.0) - 80.0);
    });
    assert!(found.contains(&Rule::Rate), "{found:?}");
    Ok(())
}

/// The record with the true position moved by `offset(tick)` to the left, and the brake reported in
/// `braking`.
fn displaced(
    record: &Record,
    braking: std::ops::Range<u64>,
    offset: impl Fn(u64) -> f64,
) -> Record {
    let mut messages = record.messages().to_vec();
    for message in &mut messages {
        let tick = message.stamp("tick");
        match message.topic.as_str() {
            "truth" => {
                let left = message.fields["pose"][1].as_f64().unwrap_or(0.0);
                message.fields["pose"][1] = json!(left + offset(tick));
                // The heading is 0, so left in the body is left in the world.
                let speed = message.fields["velocity"][1].as_f64().unwrap_or(0.0);
                let moved = (offset(tick + 1) - offset(tick)) / 0.02;
                message.fields["velocity"][1] = json!(speed + moved);
            }
            "state" if braking.contains(&tick) => message.fields["fallback_level"] = json!("brake"),
            _ => {}
        }
    }
    Record::of_messages(messages)
}

#[test]
fn a_robot_that_leaves_its_path_on_fresh_plans_is_found() -> Outcome {
    let (record, limits, course) = good_eight()?;
    let judged = |braking, offset: &dyn Fn(u64) -> f64| {
        tracking::judge(&displaced(&record, braking, offset), &limits, &course, Windows::default())
    };
    let good = judged(0..0, &|_| 0.0)?;
    assert_eq!(good.violations, []);
    assert!(good.share.is_some_and(|share| share > 0.0 && share < 0.5), "{:?}", good.share);

    // 0.3 m/s of deviation, on fresh plans alone.
    let after = |tick: u64, from: u64| tick.saturating_sub(from) as f64 * 0.02;
    let drifting = judged(0..0, &|tick| 0.3 * after(tick, 300))?;
    let rules: Vec<Rule> = drifting.violations.iter().map(|violation| violation.rule).collect();
    assert_eq!(rules, [Rule::Tracking]);
    let tick = drifting.violations.first().map_or(0, |violation| violation.tick);
    assert!((301..315).contains(&tick), "it is found at tick {tick}");
    Ok(())
}

#[test]
fn a_brake_explains_a_distance_and_a_time_to_catch_up_and_no_more() -> Outcome {
    let (record, limits, course) = good_eight()?;
    let judged = |offset: &dyn Fn(u64) -> f64| {
        let record = displaced(&record, 300..315, offset);
        tracking::judge(&record, &limits, &course, Windows::default())
            .map(|tracked| tracked.violations.len())
    };
    // Behind by 0.2 m while it brakes for 0.3 s.
    let behind = |tick: u64| 0.2 * (tick.clamp(300, 315) - 300) as f64 / 15.0;
    let back_within = |ticks: f64| {
        move |tick: u64| {
            let gone = tick.saturating_sub(315) as f64 / ticks;
            behind(tick) * (1.0 - gone).max(0.0)
        }
    };
    assert_eq!(judged(&back_within(25.0))?, 0, "back within half a second");
    assert_eq!(judged(&back_within(1e9))?, 1, "never back");
    assert_eq!(judged(&back_within(150.0))?, 1, "back within three seconds");
    let away = |tick: u64| 12.0 * behind(tick);
    assert_eq!(judged(&away)?, 1, "8 m/s while it brakes");
    Ok(())
}

#[test]
fn an_uncounted_missing_message_is_found_for_every_sender() -> Outcome {
    let (record, limits) = good_run()?;
    for topic in ["state", "command", "residual", "snapshot", "plan", "truth"] {
        let mut messages = record.messages().to_vec();
        let index = messages
            .iter()
            .rposition(|message| message.topic == topic && message.stamp("tick") == 50)
            .ok_or(topic)?;
        messages.remove(index);
        let violations = judge(&Record::of_messages(messages), &limits);
        assert_eq!(
            violations.iter().map(|violation| violation.rule).collect::<Vec<_>>(),
            [Rule::Count],
            "{topic}: {violations:?}"
        );
        let found = violations.first().map(|violation| violation.found.clone()).unwrap_or_default();
        assert!(found.starts_with(topic), "{found}");
    }
    Ok(())
}
