//! Promise: the oracle finds nothing in a good run, and in a bad one exactly what is bad.

use coxswain::assembly::Assembly;
use coxswain::in_process;
use coxswain::options::Options;
use promises::oracle::{Limits, Rule, judge};
use promises::{Message, Outcome, Record, repository};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;

/// Ten seconds of the paper's scenario in lock step.
fn good_run() -> Result<(Record, Limits), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let mut assembly =
        Assembly::read(&Options::of_graph(&repository().join("deploy/graphs/local.toml")))?;
    assembly.scenario.duration_s = 10.0;
    // Tight enough that a change can be too fast within the wheels' speed.
    assembly.robot.limits.input_rate_mps2 = 20.0;
    let run = folder.path().join("run");
    fs::create_dir(&run)?;
    in_process::run(&assembly, &run)?;
    Ok((Record::read(&run)?, Limits::of(&assembly)))
}

/// The record in which the tail of the answer to tick 49 acted in the period that began with tick 50, as it was said, or as `said` changes it.
fn bridged(record: &Record, said: impl Fn(&mut Value)) -> Vec<Message> {
    let mut messages = record.messages().to_vec();
    let answer = messages
        .iter()
        .find(|message| message.topic == "truth" && message.stamp("tick") == 50)
        .map(|message| message.says.clone());
    for message in &mut messages {
        match (message.topic.as_str(), message.stamp("tick")) {
            // The wheels keep what they had, so that is what the tail must have been.
            ("command", 49) => {
                message.says["tail"][0] = message.says["input"].clone();
                said(&mut message.says["tail"][0]);
            }
            ("truth", 51) => {
                for field in ["wheel_command", "acting_tick"] {
                    message.says[field] =
                        answer.as_ref().map_or(Value::Null, |truth| truth[field].clone());
                }
                (message.says["rung"], message.says["reason"]) =
                    (json!("stored tail"), json!("command missing"));
            }
            _ => {}
        }
    }
    messages
}

/// The rules that `record` violates once `change` was made to the messages of `topic` at `tick`.
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
        change(&mut message.says);
    }
    judge(&Record::of_messages(messages), limits).iter().map(|violation| violation.rule).collect()
}

/// The record with the plant's messages changed as if it had braked by itself from straight on, between tick 50 and `until`, with
/// commands accepted again from `answered_from` on.
fn braked(record: &Record, limits: &Limits, until: u64, answered_from: u64) -> Vec<Message> {
    let mut messages = record.messages().to_vec();
    let ramp = limits.brake[0] * limits.period_s / limits.wheel_radius_m;
    let mut wheel: f64 = 54.0;
    for message in &mut messages {
        let tick = message.stamp("tick");
        if !matches!(message.topic.as_str(), "state" | "truth") || !(50..until).contains(&tick) {
            continue;
        }
        message.says["rung"] = json!("brake");
        message.says["reason"] = json!("command missing");
        if message.topic == "state" && tick < answered_from {
            message.says["accepted_tick"] = json!(48);
        }
        if message.topic == "truth" {
            wheel = (wheel - ramp).max(0.0);
            message.says["wheel_command"] = json!(vec![wheel; 4]);
            for field in ["acting_epoch", "acting_tick", "acting_age_nanos"] {
                message.says[field] = json!(0);
            }
        }
    }
    messages
}

fn rules(messages: Vec<Message>, limits: &Limits) -> Vec<Rule> {
    judge(&Record::of_messages(messages), limits).iter().map(|violation| violation.rule).collect()
}

#[test]
fn a_good_run_is_acquitted_and_each_bad_one_is_found_out_for_what_is_bad() -> Outcome {
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
        [Rule::Rate, Rule::Said]
    );
    let another = |truth: &mut Value| {
        truth["wheel_command"][0] =
            json!(truth["wheel_command"][0].as_f64().unwrap_or(0.0) + 0.001);
    };
    assert_eq!(found(("truth", 60), &another), [Rule::Said]);
    assert_eq!(
        found(("command", 59), &|command| command["input"] = json!([0.0, 0.0, 0.0])),
        [Rule::Said]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["acting_age_nanos"] = json!(301_000_000)),
        [Rule::Age]
    );
    assert_eq!(
        found(("truth", 60), &|truth| truth["acting_tick"] = json!(56)),
        [Rule::Age, Rule::Said]
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
    assert_eq!(found(("state", 60), &|state| state["rung"] = json!("lqr")), [Rule::Reason]);
    assert_eq!(
        found(("state", 60), &|state| (state["rung"], state["reason"]) =
            (json!("lqr"), json!("solver failed"))),
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
    let mut messages = braked(&record, &limits, 60, 57);
    for message in messages
        .iter_mut()
        .filter(|message| message.topic == "truth" && message.stamp("tick") == 51)
    {
        message.says["wheel_command"] = json!(vec![54.0; 4]);
    }
    assert_eq!(rules(messages, &limits), [Rule::Ramp]);
    Ok(())
}

#[test]
fn what_bridges_a_gap_is_the_tail_that_was_said() -> Outcome {
    let (record, limits) = good_run()?;
    assert_eq!(rules(bridged(&record, |_| ()), &limits), []);
    assert_eq!(rules(bridged(&record, |entry| entry[0] = json!(0.5)), &limits), [Rule::Said]);
    Ok(())
}

#[test]
fn the_wheels_do_not_leap_into_the_brake_nor_out_of_it() -> Outcome {
    let (record, limits) = good_run()?;
    let at = |tick: u64, wheels: f64| {
        let mut messages = braked(&record, &limits, 60, 57);
        for message in messages
            .iter_mut()
            .filter(|message| message.topic == "truth" && message.stamp("tick") == tick)
        {
            message.says["wheel_command"] = json!(vec![wheels; 4]);
        }
        rules(messages, &limits)
    };
    let most = limits.rate[0] * limits.period_s / limits.wheel_radius_m;
    let first = 54.0 - limits.brake[0] * limits.period_s / limits.wheel_radius_m;
    assert!(!at(50, first - 0.5 * most).contains(&Rule::Rate), "a step of the tail, then the ramp");
    assert!(at(50, -100.0).contains(&Rule::Rate), "a leap into the brake");
    assert!(at(60, -100.0).contains(&Rule::Rate), "a leap out of it");
    Ok(())
}

#[test]
fn a_message_that_nobody_has_counted_is_missed_whoever_sent_it() -> Outcome {
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
