use super::*;
use serde_json::json;

const MS: u64 = 1_000_000;

/// The result for a controller in use from the times `used` on, which ended at the times `ends`
/// \[ms\].
fn judged(used: &[u64], ends: &[u64]) -> (Option<f64>, Vec<String>) {
    let state = |(epoch, at): (usize, &u64)| Message {
        topic: "state".to_owned(),
        fields: json!({
            "stamp": {"epoch": 1, "sent_nanos": at * MS},
            "accepted_epoch": epoch + 1,
            "fallback_level": "fresh plan",
        }),
    };
    let record = Record::of_messages(used.iter().enumerate().map(state).collect());
    let end = |at: &u64| Injected {
        kind: "kill".into(),
        participant: Some(Participant::Controller),
        pid: None,
        nanos: at * MS,
        millis: None,
    };
    let ends: Vec<Injected> = ends.iter().map(end).collect();
    let mut violations = Vec::new();
    let worst = judge_restarts(&record, Participant::Controller, &ends, &mut violations);
    (worst, violations)
}

#[test]
fn a_process_that_the_robot_does_not_need_restarts_after_it_is_found_hung() {
    let limits = Participant::ALL.iter().map(|&who| {
        let fault = |millis| Injected {
            kind: "stop".into(),
            participant: Some(who),
            pid: None,
            nanos: 0,
            millis,
        };
        [back_within_s(who, &fault(None)), back_within_s(who, &fault(Some(4000)))]
    });
    let limits: Vec<_> = limits.collect();
    assert_eq!(limits, [[1.0, 1.0], [1.0, 1.0], [5.0, 7.5], [1.0, 3.5], [1.0, 3.5], [1.0, 1.0]]);
}

#[test]
fn a_restart_counts_from_the_first_end_without_a_successor() {
    assert_eq!(judged(&[0, 1300, 2400], &[1000, 2000]), (Some(0.4), Vec::new()));
    let (worst, violations) = judged(&[0, 3200], &[1000, 1900, 2800]);
    assert_eq!(
        (worst, violations.len()),
        (Some(2.2), 1),
        "nobody was in use when it was ended again: {violations:?}"
    );
    assert_eq!(
        judged(&[0, 1500], &[1000, 1060]),
        (Some(0.44), Vec::new()),
        "ended on purpose on its way back"
    );
    let (worst, violations) = judged(&[0, 6000], &[1000, 1900, 1960, 2800]);
    assert_eq!(
        (worst, violations.len()),
        (Some(5.0), 1),
        "an end on purpose in between makes nothing good: {violations:?}"
    );
    let (_, violations) = judged(&[0], &[1000, 1900]);
    assert!(violations.iter().any(|found| found.contains("never in use again")), "{violations:?}");
}
