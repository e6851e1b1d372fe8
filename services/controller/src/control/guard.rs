//! Guard: whether the robot is near its reference, whether plans hold it, which current limits the
//! measurements contradict, and whether the gate would accept a command.

use super::planner::Planner;
use crate::adopt::{Event, Handover};
use crate::currents::{Contradicted, Currents, Foretold};
use crate::fallback::FallbackChoice;
use crate::grip::Grip;
use crate::knowledge::Knowledge;
use crate::loop_judge::{LoopJudge, Passed};
use crate::mpc::Mpc;
use crate::settings::{Identify, Method, Settings};
use crate::tracking::TrackingJudge;
use gate::Bounds;
use gate::accept::{AtArrival, judge};
use model::Velocity;
use model::delay::DELAY_MAX;
use protocol::message::{Command, FallbackLevel, PlantState, Reason};

/// Everything that can replace a plan by another command.
pub(super) struct Guard {
    /// Limits that the gate enforces.
    pub(super) bounds: Bounds,
    /// Chooses between plan, shifted plan and LQR.
    pub(super) choice: FallbackChoice,
    tracking: TrackingJudge,
    /// Judges whether the plans hold the robot; `None` for a controller that uses plans alone.
    loop_judge: Option<LoopJudge>,
    currents: Currents,
    grip: Grip,
    /// Motor currents that the last plans predicted, newest first.
    foretold: [Foretold; DELAY_MAX + 1],
}

impl Guard {
    pub(super) fn new(settings: &Settings) -> Self {
        let (robot, period_nanos) = (&settings.robot, settings.run.period_nanos);
        let period = period_nanos as f64 * 1e-9;
        let judged = settings.mpc.method == Method::Mpc
            && settings.mpc.identify != Identify::Off
            && settings.mpc.no_harm;
        let limits = &robot.limits;
        let largest = [limits.input_mps, limits.input_mps, limits.yaw_input_radps];
        Self {
            bounds: Bounds::new(robot, period_nanos, 0),
            choice: FallbackChoice::default(),
            tracking: TrackingJudge::new(robot),
            loop_judge: judged.then(|| LoopJudge::new(period, robot.wheels.lever_m(), largest)),
            currents: Currents::new(robot, period),
            grip: Grip::new(robot, period),
            foretold: [Foretold::default(); DELAY_MAX + 1],
        }
    }

    /// Forgets everything about the robot.
    pub(super) fn reset(&mut self) {
        self.choice.reset();
        self.currents.reset();
        self.grip.reset();
        self.foretold = [Foretold::default(); DELAY_MAX + 1];
        self.approach_reference();
    }

    /// The robot approaches its reference: after a start, a change of it, or an obstacle.
    pub(super) fn approach_reference(&mut self) {
        self.tracking.reset();
        if let Some(judge) = &mut self.loop_judge {
            judge.reset();
        }
    }

    /// Judges whether the robot is too far from its reference.
    pub(super) fn judge_tracking(
        &mut self,
        state: &PlantState,
        planner: &Planner,
        handover: &Handover,
    ) {
        let (tick, before) = (state.stamp.tick, self.tracking.request());
        let reference = planner.reference_at(tick).pose;
        let request = self.tracking.judge(&state.pose, &reference, state.fallback_level());
        if request != before && request != Reason::None {
            handover.note(Event::Stop { tick, reason: request });
        }
    }

    /// Compares the effect of the last period's input with the prediction. Current rows that the
    /// measurements contradict become inactive.
    pub(super) fn watch_period(
        &mut self,
        state: &PlantState,
        planner: &mut Planner,
        knowledge: &Knowledge,
    ) {
        let by_plans =
            matches!(state.fallback_level(), FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan);
        self.watch_floor(state, planner, knowledge);
        if by_plans {
            let foretold = &self.foretold[knowledge.delay().whole()];
            self.currents.look(foretold, state.current(), self.grip.held());
            planner.drop_current_rows(self.currents.dropped());
        }
        let Some(judge) = &mut self.loop_judge else { return };
        let believed = knowledge.state();
        match state.fallback_level() {
            FallbackLevel::Waiting | FallbackLevel::Brake | FallbackLevel::LatchedStop => {
                judge.reset();
            }
            // The robot keeps clear of an obstacle: its distance from the reference tells nothing.
            _ if planner.mpc.is_held_by_obstacle() || state.reason().is_slowed() => judge.reset(),
            FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple
                if by_plans || judge.prefers_simple() =>
            {
                let reference = planner.reference_at(state.stamp.tick);
                let point = planner.mpc.limits().admitted(&reference);
                judge.look(&Passed {
                    given: state.input,
                    acted: believed.acted,
                    pose: believed.pose,
                    velocity: believed.velocity,
                    point: &point,
                });
            }
            _ => judge.pass_over(&believed.pose),
        }
    }

    /// Compares the wheels with the floor. Plans keep to its grip.
    fn watch_floor(&mut self, state: &PlantState, planner: &mut Planner, knowledge: &Knowledge) {
        if knowledge.wheels_follow() {
            self.grip.look(&state.wheel_speed, state.current(), &state.velocity);
        } else {
            self.grip.reset();
        }
        planner.keep_to_grip(self.grip.bound());
    }

    /// Whether the body slides on the floor.
    pub(super) fn slides(&self) -> bool {
        self.grip.slides()
    }

    /// Keeps the motor currents that the chosen plan predicts, to compare them with measurements.
    pub(super) fn keep_foretold_currents(&mut self, fallback_level: FallbackLevel, mpc: &Mpc) {
        self.foretold.rotate_right(1);
        self.foretold[0] =
            if matches!(fallback_level, FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan) {
                mpc.foretold_currents()
            } else {
                Foretold::default()
            };
    }

    /// Whether the simple controller drives because plans would not hold the robot.
    pub(super) fn prefers_simple(&self) -> bool {
        self.loop_judge.as_ref().is_some_and(LoopJudge::prefers_simple)
    }

    /// The limit on a motor's current that the measured current contradicts, if there is one.
    pub(super) fn contradicted_limit(&self) -> Option<Contradicted> {
        self.currents.contradicted()
    }

    /// Wheels whose current rows the measurements contradict.
    pub(super) fn dropped_current_rows(&self) -> [bool; robot::WHEELS_MAX] {
        self.currents.dropped()
    }

    /// The stop that the controller requests of the gate.
    pub(super) fn stop_request(&self) -> Reason {
        self.tracking.request()
    }

    /// The gate's decision on the answer to `state`, as far as it can be predicted here: `acting`
    /// is the input that acts until then.
    pub(super) fn judge(
        &self,
        command: &Command,
        state: &PlantState,
        acting: Velocity,
    ) -> Result<(), Reason> {
        let at_arrival = AtArrival {
            plant_epoch: state.stamp.epoch,
            tick: state.stamp.tick,
            now: 0,
            age_nanos: Some(0),
            accepted: None,
            writer: None,
            acting,
            begun_with: acting,
            slowed: None,
        };
        judge(command, &at_arrival, &self.bounds)
    }
}
