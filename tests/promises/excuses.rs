//! Promise: a late wake-up of the machine excuses the periods that it overlaps, and no more.

use crate::oracle_judges::assembly;
use drill::catalogue::Launch;
use drill::measure::measure;
use process::Gap;
use promises::excuse::{Unseen, unseen};
use promises::oracle::Limits;
use promises::{Message, Outcome, Record};
use serde_json::json;

const MS: u64 = 1_000_000;

/// States of a drive in which nothing is recorded between two ticks, and the periods that the plant
/// counted as missed, in the Health messages before and after.
fn in_the_dark(dark: std::ops::Range<u64>, missed: u64) -> Record {
    let state = |tick: u64| Message {
        topic: "state".to_owned(),
        fields: json!({
            "stamp": {"epoch": 1, "tick": tick, "sent_nanos": (1000 + 20 * tick) * MS},
            "fallback_level": "fresh plan",
        }),
    };
    // Sent at the end of a period, right before the next state.
    let health = |tick: u64, missed: u64| Message {
        topic: "health".to_owned(),
        fields: json!({
            "stamp": {"sequence": tick, "sent_nanos": (1000 + 20 * tick) * MS - 1000},
            "participant": "plant", "deadlines_met": tick - missed, "deadlines_missed": missed,
        }),
    };
    let states = (1..60).filter(|tick| !dark.contains(tick)).map(state);
    let before = (5..60).step_by(5).filter(|tick| !dark.contains(tick));
    let healths = before.map(|tick| health(tick, if tick < dark.start { 0 } else { missed }));
    Record::of_messages(states.chain(healths).collect())
}

#[test]
fn a_late_wake_up_excuses_no_more_unseen_periods_than_it_overlaps() {
    let judged = |missed: u64, gaps: &[[u64; 2]]| {
        let record = in_the_dark(20..34, missed);
        let states: Vec<&Message> = record.of("state").collect();
        let gaps = gaps
            .iter()
            .map(|&[from, to]| Gap { from_nanos: (1000 + from) * MS, to_nanos: (1000 + to) * MS });
        unseen(&record, &states, 0.02, &gaps.collect::<Vec<_>>())
    };
    let of = |missed, unexcused| Unseen { missed, unexcused };
    assert_eq!(judged(0, &[]), of(0, 0));
    assert_eq!(judged(2, &[]), of(2, 2));
    assert_eq!(judged(1, &[[488, 494]]), of(1, 0), "within the dark");
    assert_eq!(judged(6, &[[488, 494]]), of(6, 5), "one late wake-up is not an excuse for all");
    assert_eq!(judged(1, &[[900, 906]]), of(1, 1), "the machine was late when all was recorded");
    assert_eq!(judged(8, &[[470, 570]]), of(8, 0), "100 ms, and the brake that follows");
}

#[test]
fn a_late_wake_up_excuses_a_recorded_period_only_if_the_two_overlap() -> Outcome {
    let limits = Limits { period_s: 0.02, ..Limits::of(&assembly()?) };
    let launch = Launch { undisturbed: true, ..Launch::default() };
    // The period from tick - 1 to tick is missed, and counted.
    let excused = |tick: u64, gap: [u64; 2]| {
        let mut messages = in_the_dark(20..34, 0).messages().to_vec();
        for message in messages
            .iter_mut()
            .filter(|message| message.topic == "state" && message.stamp("tick") == tick)
        {
            (message.fields["fallback_level"], message.fields["reason"]) =
                (json!("stored tail"), json!("command missing"));
        }
        let [from_nanos, to_nanos] = gap.map(|at| (1000 + at) * MS);
        let gaps = [Gap { from_nanos, to_nanos }];
        measure(&Record::of_messages(messages), &launch, &limits, &[], &gaps).excused
    };
    assert_eq!(excused(10, [185, 190]), 1);
    assert_eq!(excused(10, [165, 170]), 0, "in the period before");
    assert_eq!(excused(34, [665, 670]), 1, "the first state after the dark");
    assert_eq!(excused(34, [400, 406]), 0, "it was late in the dark, but not then");
    Ok(())
}
