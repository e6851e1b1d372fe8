//! Every figure on rows made by hand. The period is 0.1 s. The reference rests at the origin with a
//! reference speed of 2 m/s.

use super::*;
use crate::rows::TruthRow;

const PERIOD_NANOS: u64 = 100_000_000;

fn mark(epoch: u64, tick: u64) -> Mark {
    Mark { writer: 1, epoch, sequence: tick + 1, tick }
}

/// A record of one epoch in which the robot deviated by `errors(tick)` = (distance, heading, speed
/// difference).
fn record(ticks: u64, errors: impl Fn(u64) -> (f64, f64, f64)) -> Rows {
    let mut rows = Rows::of_segments(1);
    add_epoch(&mut rows, 1, ticks, errors);
    rows
}

fn add_epoch(rows: &mut Rows, epoch: u64, ticks: u64, errors: impl Fn(u64) -> (f64, f64, f64)) {
    for tick in 0..ticks {
        let (distance, heading, speed) = errors(tick);
        let (pose, velocity) =
            ([distance * 0.6, -distance * 0.8, heading], [0.0, 2.0 + speed, 9.0]);
        rows.truths.push(TruthRow { stamp: mark(epoch, tick), pose, velocity });
        let reference = [0.0, 0.0, 0.0, -1.2, 1.6, 5.0];
        rows.plans.push(PlanRow {
            stamp: mark(7, tick),
            plant_epoch: epoch,
            tick_nanos: 1000 * (tick + 1),
            reference,
        });
        let (accepted_epoch, fallback_level) =
            if tick == 0 { (0, FallbackLevel::Waiting) } else { (7, FallbackLevel::FreshPlan) };
        rows.states.push(StateRow {
            stamp: mark(epoch, tick),
            accepted_epoch,
            fallback_level,
            reason: Reason::None,
            stop: Reason::None,
            pose: [0.5 + pose[0], pose[1], pose[2]],
            velocity,
        });
    }
}

fn summary(rows: &Rows) -> Summary {
    Summary::of(rows, PERIOD_NANOS)
}

fn close(figure: Option<f64>, expected: f64) -> bool {
    figure.is_some_and(|figure| (figure - expected).abs() < 1e-9)
}

#[test]
fn arrival_is_the_first_time_after_which_the_error_stays_in_the_band() {
    let rows = record(250, |tick| (if tick < 14 || tick == 20 { 0.3 } else { 0.0999 }, 0.0, 0.0));
    assert!(close(summary(&rows).arrival_s, 2.1), "a visit before tick 20 is not the arrival");
    let rows = record(250, |_| (0.05, 0.0, 0.0));
    assert_eq!(summary(&rows).arrival_s, Some(0.0), "arrived from the start");
}

#[test]
fn periods_in_which_the_gate_slows_the_robot_are_counted() {
    let mut rows = record(250, |_| (0.0, 0.0, 0.0));
    assert_eq!(summary(&rows).periods_slowed, 0);
    for state in &mut rows.states[100..140] {
        state.reason = Reason::ProtectiveStop;
    }
    rows.states[200].reason = Reason::SpeedZone;
    assert_eq!(summary(&rows).periods_slowed, 41);
}

#[test]
fn each_band_has_its_own_arrival() {
    let approach = |tick: u64| match tick {
        0..10 => 0.3,
        10..20 => 0.09,
        20..30 => 0.04,
        _ => 0.03,
    };
    let rows = record(250, |tick| (approach(tick), 0.0, 0.0));
    let arrivals = summary(&rows).arrival_by_band_s;
    assert_eq!(arrivals.keys().copied().collect::<Vec<_>>(), ["0.02", "0.05", "0.10"]);
    assert_eq!(arrivals["0.02"], None);
    assert!(close(arrivals["0.05"], 2.0) && close(arrivals["0.10"], 1.0), "{arrivals:?}");
}

#[test]
fn the_edge_of_the_band_belongs_to_it() {
    let rows = record(50, |tick| (if tick < 10 { 1.0 } else { 0.0 }, 0.0, 0.0));
    let mut on_the_edge = rows.clone();
    for truth in &mut on_the_edge.truths[10..] {
        truth.pose = [ARRIVAL_BAND_M, 0.0, 0.0];
    }
    assert_eq!(summary(&on_the_edge).arrival_s, summary(&rows).arrival_s);
}

#[test]
fn a_robot_that_never_comes_near_has_not_arrived() {
    assert_eq!(summary(&record(250, |_| (0.2, 0.0, 0.0))).arrival_s, None);
}

#[test]
fn a_robot_that_leaves_the_band_at_the_very_end_has_not_arrived() {
    let rows = record(250, |tick| if tick == 249 { (0.11, 0.0, 0.08) } else { (0.0, 0.0, 0.0) });
    let summary = summary(&rows);
    assert_eq!((summary.arrival_s, summary.speed_settle_s), (None, None));
    assert!(close(summary.position_max_m, 0.11));
}

#[test]
fn the_speed_settles_by_the_norm_of_the_planar_velocity() {
    let rows = record(250, |tick| (0.0, 0.0, if tick < 33 { -0.5 } else { 0.0699 }));
    let summary = summary(&rows);
    assert!(close(summary.speed_settle_s, 3.3));
    assert!(close(summary.steady_speed_error_mps, 0.0699));
}

#[test]
fn the_steady_speed_error_is_the_largest_of_the_last_ten_seconds() {
    let rows =
        record(250, |tick| (0.0, 0.0, if tick < 149 { 0.9 } else { 0.01 * (tick % 7) as f64 }));
    assert!(
        close(summary(&rows).steady_speed_error_mps, 0.06),
        "from tick 149 to 249 are ten seconds"
    );
    let rows = record(250, |tick| (0.0, 0.0, if tick == 149 { 0.9 } else { 0.0 }));
    assert!(close(summary(&rows).steady_speed_error_mps, 0.9));
}

#[test]
fn position_and_heading_figures_leave_out_the_first_three_seconds() {
    let rows = record(32, |tick| match tick {
        30 => (0.3, 0.1, 0.0),
        31 => (0.4, -0.1, 0.0),
        _ => (5.0, 1.0, 0.0),
    });
    let figures = summary(&rows);
    assert!(close(figures.position_rmse_m, 0.125_f64.sqrt()));
    assert!(close(figures.position_max_m, 0.4));
    assert!(close(figures.heading_rmse_rad, 0.1));
    let short = summary(&record(30, |_| (0.1, 0.0, 0.0)));
    assert_eq!(
        (short.position_rmse_m, short.position_max_m, short.heading_rmse_rad),
        (None, None, None)
    );
}

#[test]
fn heading_differences_are_wrapped() {
    let rows = record(40, |_| (0.0, std::f64::consts::TAU - 0.01, 0.0));
    assert!(close(summary(&rows).heading_rmse_rad, 0.01));
}

#[test]
fn a_number_that_is_not_finite_affects_only_its_own_figures() {
    for bad in [f64::NAN, f64::INFINITY] {
        let rows = record(250, |tick| (if tick == 200 { bad } else { 0.02 }, 0.0, 0.0));
        let spoilt = summary(&rows);
        assert!(close(spoilt.arrival_s, 20.1), "not within the band at that time");
        assert_eq!((spoilt.position_rmse_m, spoilt.position_max_m), (None, None));
        assert!(close(spoilt.speed_settle_s, 0.0));
        let rows = record(250, |tick| (0.0, 0.0, if tick == 249 { bad } else { 0.02 }));
        let spoilt = summary(&rows);
        assert_eq!((spoilt.speed_settle_s, spoilt.steady_speed_error_mps), (None, None));
    }
}

#[test]
fn an_empty_record_has_no_figures() {
    let empty = summary(&Rows::default());
    assert_eq!(
        (empty.arrival_s, empty.speed_settle_s, empty.steady_speed_error_mps),
        (None, None, None)
    );
    assert_eq!((empty.position_rmse_m, empty.tick_p50_us, empty.tick_max_us), (None, None, None));
    assert_eq!((empty.periods, empty.periods_missed, empty.plant_epochs), (0, 0, 0));
}

#[test]
fn a_tick_without_plan_has_no_deviation() {
    let mut rows = record(100, |tick| (if tick == 60 { 9.0 } else { 0.0 }, 0.0, 0.0));
    rows.plans.retain(|plan| plan.stamp.tick != 60);
    assert_eq!(summary(&rows).arrival_s, Some(0.0));
}

#[test]
fn tick_times_are_nearest_ranks() {
    let figures = summary(&record(200, |_| (0.0, 0.0, 0.0)));
    assert!(
        close(figures.tick_p50_us, 100.0)
            && close(figures.tick_p99_us, 198.0)
            && close(figures.tick_max_us, 200.0)
    );
    let figures = summary(&record(1, |_| (0.0, 0.0, 0.0)));
    assert!(close(figures.tick_p50_us, 1.0) && close(figures.tick_p99_us, 1.0));
}

#[test]
fn periods_count_from_the_first_accepted_command_on() {
    let mut rows = record(10, |_| (0.0, 0.0, 0.0));
    // No command is accepted up to tick 2. The plant still waited in the period of the first
    // command.
    for state in &mut rows.states[..3] {
        (state.accepted_epoch, state.fallback_level) = (0, FallbackLevel::Waiting);
    }
    rows.states[3].fallback_level = FallbackLevel::Waiting;
    rows.states[6].fallback_level = FallbackLevel::StoredTail;
    rows.states[7].fallback_level = FallbackLevel::Brake;
    rows.states[8].fallback_level = FallbackLevel::Simple;
    let figures = summary(&rows);
    assert_eq!((figures.periods, figures.periods_missed), (6, 2));
    assert_eq!(
        (
            figures.fallback_levels.on(FallbackLevel::FreshPlan),
            figures.fallback_levels.on(FallbackLevel::Simple),
            figures.fallback_levels.on(FallbackLevel::Waiting)
        ),
        (3, 1, 0)
    );
}

#[test]
fn waiting_again_after_the_first_command_is_missed() {
    let mut rows = record(10, |_| (0.0, 0.0, 0.0));
    rows.states[5].fallback_level = FallbackLevel::Waiting;
    rows.states[9].fallback_level = FallbackLevel::LatchedStop;
    let figures = summary(&rows);
    assert_eq!((figures.periods, figures.periods_missed), (9, 2));
}

#[test]
fn after_a_restart_of_the_plant_the_figures_are_over_the_last_epoch() {
    let mut rows = record(250, |_| (3.0, 0.0, 3.0));
    add_epoch(&mut rows, 2, 100, |tick| (if tick < 10 { 1.0 } else { 0.0 }, 0.0, 0.0));
    let figures = summary(&rows);
    assert_eq!(figures.plant_epochs, 2);
    assert!(close(figures.arrival_s, 1.0) && close(figures.tick_max_us, 100.0));
    assert_eq!((figures.periods, figures.periods_missed), (99, 0));
}

fn health(participant: Participant, snapshots: u64, state: (u64, u64)) -> HealthRow {
    let counts = |count| BTreeMap::from([("state".to_owned(), count)]);
    HealthRow {
        stamp: Mark::default(),
        participant: participant.text().to_owned(),
        stalled_nanos: 0,
        exposure: Exposure::Closed,
        snapshots,
        received: counts(state.0),
        lost: counts(state.1),
        last_error: String::new(),
    }
}

#[test]
fn snapshots_and_losses_are_summed_over_the_instances_of_a_process() {
    let mut rows = record(10, |_| (0.0, 0.0, 0.0));
    rows.missing = BTreeMap::from([("plan", 5)]);
    let healths = [
        health(Participant::Learner, 3, (0, 0)),
        health(Participant::Learner, 2, (0, 0)),
        health(Participant::Controller, 4, (8, 1)),
        health(Participant::Controller, 1, (9, 2)),
        health(Participant::Recorder, 0, (9, 9)),
    ];
    rows.healths = (1..).zip(healths).collect();
    let figures = summary(&rows);
    assert_eq!((figures.snapshots_published, figures.snapshots_adopted), (5, 5));
    assert_eq!(
        figures.losses["state"],
        BTreeMap::from([("controller".to_owned(), 3), ("recorder".to_owned(), 0)])
    );
    assert_eq!(figures.losses["plan"], BTreeMap::from([("recorder".to_owned(), 5)]));
    assert!(figures.losses["credit"].is_empty(), "the recorder does not read its own messages");
}

#[test]
fn one_process_that_peers_can_reach_exposes_the_whole_run() {
    let mut rows = record(10, |_| (0.0, 0.0, 0.0));
    assert_eq!(summary(&rows).exposure, Exposure::Closed);
    let exposed = |exposure| HealthRow { exposure, ..health(Participant::Gateway, 0, (0, 0)) };
    rows.healths =
        (1..).zip([Exposure::Watched, Exposure::Driven, Exposure::Closed].map(exposed)).collect();
    let figures = summary(&rows);
    assert_eq!(figures.exposure, Exposure::Driven);
    let json = serde_json::to_string(&figures).unwrap_or_default();
    assert!(json.ends_with(r#""exposure":"strangers can drive"}"#), "{json}");
}

#[test]
fn the_file_has_every_figure_in_its_place_and_every_fallback_level() {
    let json = serde_json::to_string_pretty(&summary(&record(250, |_| (f64::NAN, 0.0, 0.0))))
        .unwrap_or_default();
    let keys = [
        "arrival_s",
        "arrival_by_band_s",
        "speed_settle_s",
        "steady_speed_error_mps",
        "position_rmse_m",
        "position_max_m",
        "heading_rmse_rad",
        "tick_p50_us",
        "tick_p99_us",
        "tick_max_us",
        "periods",
        "periods_missed",
        "periods_slowed",
        "fallback_levels",
        "waiting",
        "fresh plan",
        "shifted plan",
        "simple controller",
        "stored tail",
        "brake",
        "latched stop",
        "world_stalled_s",
        "snapshots_published",
        "snapshots_adopted",
        "losses",
        "unwritten",
        "plant_epochs",
        "controller_epochs",
        "segments",
        "exposure",
    ];
    let places: Vec<_> = keys.iter().map(|key| json.find(&format!("\"{key}\":"))).collect();
    assert!(places.iter().all(Option::is_some) && places.is_sorted(), "{json}");
    assert!(json.contains("\"arrival_s\": null"));
}

#[test]
fn a_count_that_would_be_too_large_stays_at_the_largest_number() {
    let mut rows = record(3, |_| (0.0, 0.0, 0.0));
    for writer in 1..=2 {
        let counts = BTreeMap::from([("plan".to_owned(), u64::MAX)]);
        let participant = Participant::Learner.text().to_owned();
        let stamp = Mark { writer, ..mark(1, 0) };
        let (exposure, received, lost) = (Exposure::Driven, counts.clone(), counts);
        let health = HealthRow {
            stamp,
            participant,
            stalled_nanos: u64::MAX,
            snapshots: u64::MAX,
            exposure,
            received,
            lost,
            last_error: String::new(),
        };
        rows.healths.insert(writer, health);
    }
    let summary = summary(&rows);
    assert_eq!(summary.snapshots_published, u64::MAX);
    assert_eq!(summary.losses["plan"][Participant::Learner.text()], u64::MAX);
    assert!(summary.world_stalled_s > 1.8e10);
}

#[test]
fn without_truth_the_figures_are_measured_and_marked_so() {
    let mut rows = record(100, |_| (0.0, 0.0, 0.0));
    assert_eq!(summary(&rows).figures_of, "truth");
    assert!(close(summary(&rows).position_rmse_m, 0.0));
    rows.truths.clear();
    assert_eq!(summary(&rows).figures_of, "measured");
    assert!(close(summary(&rows).position_rmse_m, 0.5));
}

#[test]
fn errors_of_processes_are_in_the_summary_once() {
    let mut rows = record(3, |_| (0.0, 0.0, 0.0));
    for (sequence, error) in (1..).zip(["", "too slow", "too slow", "", "too late", "too slow"]) {
        let of_controller = health(Participant::Controller, 0, (0, 0));
        let stamp = Mark { sequence, ..Mark::default() };
        rows.add_health(HealthRow { stamp, last_error: error.into(), ..of_controller });
    }
    assert_eq!(summary(&rows).told, ["controller: too slow", "controller: too late"]);
}

#[test]
fn stops_are_listed_with_their_reason_and_their_end() {
    let mut rows = record(40, |_| (0.0, 0.0, 0.0));
    for state in &mut rows.states[10..20] {
        state.stop = Reason::PositionError;
    }
    for state in &mut rows.states[30..] {
        state.stop = Reason::BadState;
    }
    let (at, resumed) = (10.0 * PERIOD_NANOS as f64 / 1e9, 20.0 * PERIOD_NANOS as f64 / 1e9);
    let told: Vec<_> = summary(&rows).stops;
    assert_eq!(
        (told[0].reason, told[0].at_s, told[0].resumed_s),
        (Reason::PositionError, at, Some(resumed))
    );
    assert_eq!((told[1].reason, told[1].resumed_s, told.len()), (Reason::BadState, None, 2));
}
