use super::*;
use crate::event::{Counter, Sort};
use bytemuck::Zeroable;
use protocol::message::{FallbackLevel, Phase, Reason};

const PLANT: Participant = Participant::Plant;

fn state(tick: u64, level: FallbackLevel, reason: Reason) -> PlantState {
    let mut state =
        PlantState { fallback_level: level.code(), reason: reason.code(), ..PlantState::zeroed() };
    (state.stamp.tick, state.stamp.epoch, state.stamp.writer) = (tick, 1, 1);
    state
}

fn health(who: Participant, pid: u32, phase: Phase, error: &str) -> Health {
    let mut health =
        Health { participant: who.code(), pid, phase: phase.code(), ..Health::zeroed() };
    health.set_last_error(error);
    health
}

/// What has happened, oldest first.
fn events(run: &RunView) -> Vec<What> {
    run.events_since(0).map(|event| event.what.clone()).collect()
}

#[test]
fn a_restart_an_error_silence_and_a_loss_are_one_event_each() {
    let begin = Instant::now();
    let after = |millis| begin + Duration::from_millis(millis);
    let mut run = RunView::default();
    let of = |pid, phase, error| health(Participant::Recorder, pid, phase, error);
    run.receive_health(&of(1, Phase::Running, ""), begin);
    run.receive_health(&of(1, Phase::Degraded, "no disk"), after(100));
    run.receive_health(&of(1, Phase::Degraded, "no disk"), after(200));
    run.receive_health(&of(1, Phase::Running, ""), after(300));
    for millis in [1200, 1400, 1500] {
        run.look_for_silence(after(millis));
    }
    let mut again = of(2, Phase::Running, "");
    for (lost, millis) in [(0, 1600), (3, 1700), (4, 1800), (5, 1900), (5, 2900)] {
        again.lost[0] = lost;
        run.receive_health(&again, after(millis));
    }
    assert_eq!(run.processes[&Participant::Recorder].starts, 2);
    let lost = |more| What::Counted(Counter::Lost, more);
    let expected = [
        What::Error(Phase::Degraded, "no disk".into()),
        What::Phase(Phase::Degraded, Phase::Running),
        What::Silent,
        What::Restarted(2),
        lost(3),
        lost(2),
    ];
    assert_eq!(events(&run), expected);
}

#[test]
fn a_process_that_is_received_again_was_silent_and_a_finished_one_may_be_silent() {
    let begin = Instant::now();
    let after = |seconds| begin + Duration::from_secs(seconds);
    let mut run = RunView::default();
    run.receive_health(&health(PLANT, 1, Phase::Running, ""), begin);
    run.receive_health(&health(Participant::Learner, 2, Phase::Finished, ""), begin);
    run.look_for_silence(after(5));
    run.receive_health(&health(PLANT, 1, Phase::Running, ""), after(6));
    assert_eq!(events(&run), [What::Silent, What::SendsAgain]);
    assert!(!run.processes[&Participant::Learner].is_silent(after(9)));
    assert!(run.processes[&PLANT].is_silent(after(9)));
}

#[test]
fn an_error_in_the_first_message_is_an_event_and_earlier_counts_are_none() {
    let mut run = RunView::default();
    let mut first = health(Participant::Learner, 1, Phase::Running, "the fit was given up");
    first.deadlines_missed = 7;
    run.receive_health(&first, Instant::now());
    run.receive_health(&first, Instant::now());
    let expected = What::Error(Phase::Running, "the fit was given up".into());
    assert_eq!(events(&run), [expected]);
}

#[test]
fn a_change_of_level_or_cause_and_a_refusal_are_events() {
    use FallbackLevel::{Brake, FreshPlan};
    let mut run = RunView::default();
    let mut refused = state(4, FreshPlan, Reason::TooOld);
    refused.refused = 1;
    for state in [
        state(0, FreshPlan, Reason::None),
        state(1, FreshPlan, Reason::None),
        state(2, Brake, Reason::Missing),
        state(3, FreshPlan, Reason::None),
        refused,
    ] {
        assert!(!run.receive_state(&state));
    }
    let expected = [
        (2, What::Level(FreshPlan, Brake, Reason::Missing)),
        (3, What::Level(Brake, FreshPlan, Reason::None)),
        (4, What::Level(FreshPlan, FreshPlan, Reason::TooOld)),
        (4, What::Refused(Reason::TooOld)),
    ];
    let events: Vec<(u64, What)> =
        run.events_since(0).map(|event| (event.tick, event.what.clone())).collect();
    assert_eq!(events, expected);
    let sorts: Vec<Sort> = run.events_since(0).map(|event| event.what.kind().1).collect();
    assert_eq!(sorts, [Sort::Fault, Sort::Mended, Sort::Detail, Sort::Fault]);
}

#[test]
fn each_phase_of_a_goal_is_one_event_and_its_target_is_shown_until_it_is_given_up() {
    let mut run = RunView::default();
    let mut goal = Goal { id: 3, target: [2.0, 1.0, 0.5], ..Goal::zeroed() };
    let mut shown = Vec::new();
    for phase in [GoalPhase::Active, GoalPhase::Active, GoalPhase::Reached, GoalPhase::Preempted] {
        goal.phase = phase.code();
        run.receive_goal(&goal);
        shown.push(run.target());
    }
    assert_eq!(run.noted(), 3);
    assert_eq!(shown, [Some([2.0, 1.0]), Some([2.0, 1.0]), Some([2.0, 1.0]), None]);
}

#[test]
fn another_plant_begins_a_new_run_without_obstacles() {
    let begin = Instant::now();
    let mut run = RunView::default();
    run.receive_state(&state(70, FallbackLevel::FreshPlan, Reason::None));
    run.receive_obstacles(&Obstacles::zeroed(), begin);
    let mut first = state(0, FallbackLevel::FreshPlan, Reason::None);
    (first.stamp.epoch, first.refused) = (2, 9);
    assert!(run.receive_state(&first));
    assert_eq!((run.tick(), run.obstacles.len()), (0, 0));
    assert_eq!(events(&run), [What::NewRun(2)]);
}

#[test]
fn obstacles_are_shown_until_their_list_is_too_old() {
    let begin = Instant::now();
    let mut run = RunView::default();
    run.receive_obstacles(&Obstacles { valid_s: 0.5, ..Obstacles::zeroed() }, begin);
    assert!(!run.drop_old_obstacles(begin + Duration::from_millis(1400)));
    assert!(run.drop_old_obstacles(begin + Duration::from_millis(1600)));
    assert!(run.obstacles.is_empty());
}

#[test]
fn the_worst_exposure_counts() {
    let mut run = RunView::default();
    assert_eq!(run.exposure(), Exposure::Closed);
    for (who, exposure) in [(PLANT, Exposure::Watched), (Participant::Learner, Exposure::Closed)] {
        let exposure = exposure.code();
        let health = Health { exposure, ..health(who, 1, Phase::Running, "") };
        run.receive_health(&health, Instant::now());
    }
    assert_eq!(run.exposure(), Exposure::Watched);
}

#[test]
fn the_last_events_are_kept_and_each_has_its_number() {
    let mut run = RunView::default();
    for line in 0..100 {
        run.note(PLANT, What::Change(format!("{line}")));
    }
    let since = |told| run.events_since(told).count();
    assert_eq!((since(0), since(99), since(run.noted())), (EVENTS_MAX, 1, 0));
}
