//! Predict and optimise: the reference ahead, the targets, and the plan. Also the inputs of the
//! controllers that need no plan.

use super::reference_clock::ReferenceClock;
use super::seen::Seen;
use super::tuning::Tuned;
use crate::explanations::Model;
use crate::fallback;
use crate::goal::Outlook;
use crate::knowledge::Knowledge;
use crate::mpc::{Mpc, Solved, Turn};
use crate::reference::{Reference, ReferencePoint};
use crate::settings::Method;
use model::Pose;
use model::{AXES, State, Velocity};
use protocol::clock::monotonic_nanos;
use protocol::message::PlantState;

/// Iterations per period of a controller with foresight. It is meant to be accurate, not fast.
const FORESEEING_ITERATIONS: usize = 2;

/// The conditions for which plan and targets are ready.
#[derive(Debug, Clone, Copy)]
struct Prepared {
    tick: u64,
    models: [Model; AXES],
}

/// Optimiser, reference, and the preparation of the next tick.
pub(super) struct Planner {
    /// The optimiser and its last plan.
    pub(super) mpc: Mpc,
    method: Method,
    reference: Reference,
    clock: ReferenceClock,
    /// Obstacles of the newest lists.
    pub(super) seen: Seen,
    /// The reference at the prepared tick and at as many later ticks as delay and horizon can need.
    points: Vec<ReferencePoint>,
    /// Time budget of an answer; `None` in lock step \[ns\].
    budget_nanos: Option<u64>,
    /// `None` until there is a first plan.
    prepared: Option<Prepared>,
}

impl Planner {
    pub(super) fn new(parts: Tuned, method: Method, period_s: f64) -> Self {
        let Tuned { mpc, reference, points, budget_nanos, .. } = parts;
        Self {
            mpc,
            method,
            reference: reference.unwrap_or_default(),
            clock: ReferenceClock::default(),
            seen: Seen::new(period_s),
            points,
            budget_nanos,
            prepared: None,
        }
    }

    /// The table of the reference.
    pub(super) fn reference(&self) -> &Reference {
        &self.reference
    }

    /// The reference at the prepared tick and later.
    pub(super) fn points(&self) -> &[ReferencePoint] {
        &self.points
    }

    /// Whether there is a plan, or has been one since the last reset.
    pub(super) fn has_begun(&self) -> bool {
        self.prepared.is_some()
    }

    /// From now on the current rows of these wheels are inactive.
    pub(super) fn drop_current_rows(&mut self, wheels: [bool; robot::WHEELS_MAX]) {
        self.mpc.drop_current_rows(wheels);
    }

    /// From now on plans keep to a floor that can hold this share of the limit on currents.
    pub(super) fn keep_to_grip(&mut self, grip: f64) {
        self.mpc.keep_to_grip(grip);
    }

    /// Forgets everything: the next plan begins at the next state.
    pub(super) fn reset(&mut self) {
        self.mpc.reset();
        self.prepared = None;
        self.seen.forget();
        self.clock = ReferenceClock::default();
    }

    /// Drops the last plan.
    pub(super) fn drop_plan(&mut self) {
        self.mpc.reset();
    }

    /// Starts the time budget of the answer to `tick`, and prepares for it if that has not been
    /// done before the state arrived.
    pub(super) fn begin_answer(&mut self, tick: u64, measured: &State, knowledge: &mut Knowledge) {
        let until = self.budget_nanos.map(|budget| monotonic_nanos() + budget);
        self.mpc.take_turn(Turn { tick: Some(tick), until });
        if self.prepared.is_none_or(|prepared| prepared.tick != tick) {
            self.prepare(tick, measured, knowledge);
        }
    }

    /// Shifts the plan to `tick` and computes its targets with the present belief. A first plan
    /// begins at `state`.
    fn prepare(&mut self, tick: u64, state: &State, knowledge: &mut Knowledge) {
        knowledge.look(tick);
        knowledge.settle_delay();
        let period_s = knowledge.main().period;
        self.mpc.keep_to_ramp(knowledge.ramp_mps2().map(|rate| rate * period_s));
        if self.prepared.is_none() {
            self.mpc.begin_at(state);
        }
        self.look_ahead(tick);
        self.look_around(tick, knowledge);
        self.mpc.prepare(planned(&self.points, knowledge), &knowledge.belief());
        self.expect_errors(knowledge);
        self.prepared = Some(Prepared { tick, models: knowledge.models() });
    }

    /// Prepares for `tick`, before its state arrives, with all work that does not need this state.
    /// The robot was in `state` one tick before, and `commanded` is the input since.
    pub(super) fn prepare_ahead(
        &mut self,
        tick: u64,
        state: &State,
        commanded: &Velocity,
        knowledge: &mut Knowledge,
    ) {
        self.prepare(tick, state, knowledge);
        if self.method == Method::Mpc {
            let points = planned(&self.points, knowledge);
            self.mpc.expect(commanded, points, &knowledge.belief());
        }
    }

    /// The reference at `tick` and later.
    fn look_ahead(&mut self, tick: u64) {
        for (slot, offset) in self.points.iter_mut().zip(0..) {
            *slot = self.clock.point(&self.reference, tick + offset);
        }
    }

    /// Chooses the obstacles of the plan, which begins where the inputs under way end.
    fn look_around(&mut self, tick: u64, knowledge: &Knowledge) {
        let begin = tick + knowledge.delay().whole() as u64;
        self.mpc.see_obstacles(self.seen.at(begin));
    }

    fn expect_errors(&mut self, knowledge: &mut Knowledge) {
        let under_way = knowledge.delay().whole();
        self.mpc.expect_errors(under_way, |at| knowledge.step_variance(at));
    }

    /// Exchanges the parts that depend on settings. The plan continues.
    pub(super) fn tune(&mut self, tuned: &mut Tuned, knowledge: &mut Knowledge) {
        tuned.mpc.inherit(&self.mpc);
        std::mem::swap(&mut self.mpc, &mut tuned.mpc);
        std::mem::swap(&mut self.points, &mut tuned.points);
        std::mem::swap(&mut self.budget_nanos, &mut tuned.budget_nanos);
        if let Some(reference) = &mut tuned.reference {
            std::mem::swap(&mut self.reference, reference);
        }
        self.aim_again(knowledge);
    }

    /// Exchanges the reference for one whose ticks are those of the plant. The plan continues.
    pub(super) fn follow(&mut self, reference: &mut Reference, knowledge: &mut Knowledge) {
        std::mem::swap(&mut self.reference, reference);
        self.clock = ReferenceClock::default();
        self.aim_again(knowledge);
    }

    /// From now on the robot holds `pose`.
    pub(super) fn hold(&mut self, pose: Pose) {
        self.clock = ReferenceClock::Holds(pose);
    }

    /// From now on the robot holds `pose`, and the plan continues.
    pub(super) fn hold_now(&mut self, pose: Pose, knowledge: &mut Knowledge) {
        self.hold(pose);
        self.aim_again(knowledge);
    }

    /// Lets the reference brake and wait if the robot was held before `tick`, by a gate that is shut
    /// or by an obstacle. The robot needs `braking` periods to a standstill. Otherwise it runs.
    pub(super) fn let_reference_wait(
        &mut self,
        waits: bool,
        tick: u64,
        braking: f64,
        knowledge: &mut Knowledge,
    ) {
        let before = self.clock;
        self.clock.look(waits, tick, braking);
        if self.clock != before {
            self.aim_again(knowledge);
        }
    }

    /// The gate slowed the robot before `state`: it did not do what the plan says.
    pub(super) fn plan_again(&mut self, state: &PlantState, knowledge: &mut Knowledge) {
        let (pose, velocity) = (state.pose, state.velocity);
        self.mpc.begin_again(&State { pose, velocity, ..State::default() });
        self.aim_again(knowledge);
    }

    /// The reference at `tick`, by its own clock.
    pub(super) fn reference_at(&self, tick: u64) -> ReferencePoint {
        self.clock.point(&self.reference, tick)
    }

    /// Tick at whose time the reference is at `tick`.
    pub(super) fn reference_tick(&self, tick: u64) -> u64 {
        self.clock.reference_tick(tick)
    }

    /// Writes the reference ahead into `outlook`. False if there is none yet.
    pub(super) fn write_ahead(&self, outlook: &mut Outlook) -> bool {
        let Some(prepared) = self.prepared else { return false };
        outlook.tick = prepared.tick;
        outlook.points.clear();
        let room = outlook.points.capacity();
        outlook.points.extend(self.points.iter().take(room));
        outlook.obstacles.clear();
        outlook.obstacles.extend(self.seen.at(prepared.tick));
        true
    }

    fn aim_again(&mut self, knowledge: &mut Knowledge) {
        if let Some(Prepared { tick, .. }) = self.prepared {
            self.look_ahead(tick);
            self.look_around(tick, knowledge);
            self.mpc.aim(planned(&self.points, knowledge), &knowledge.belief());
            self.expect_errors(knowledge);
        }
    }

    /// Does the work of an answer once, and changes nothing.
    pub(super) fn rehearse(&mut self, knowledge: &Knowledge) {
        if self.prepared.is_some() {
            self.mpc.rehearse(
                &knowledge.last_command(),
                planned(&self.points, knowledge),
                &knowledge.belief(),
            );
        }
    }

    /// Improves the plan for the prepared tick from the measured state.
    pub(super) fn plan(&mut self, measured: &State, knowledge: &mut Knowledge) -> Solved {
        if let Some(Prepared { tick, models }) = self.prepared {
            knowledge.look(tick);
            if models != knowledge.models() {
                self.mpc.forget_expectation();
            }
        }
        let (belief, last, begin) =
            (knowledge.belief(), knowledge.last_command(), knowledge.ahead(measured));
        let points = planned(&self.points, knowledge);
        let mut solved = self.mpc.iterate(&begin, &last, points, &belief);
        if knowledge.foresees() {
            for _ in 1..FORESEEING_ITERATIONS {
                solved = self.mpc.iterate(&begin, &last, points, &belief);
            }
        }
        solved
    }

    /// Input without a plan: the LQR on the main model.
    pub(super) fn lqr(&self, measured: &State, knowledge: &Knowledge) -> Velocity {
        let begin = knowledge.ahead(measured);
        let point = planned(&self.points, knowledge).first().copied().unwrap_or_default();
        let disturbance = knowledge.disturbance();
        let main_target =
            self.mpc.main_target(knowledge.main(), &point, begin.pose[2], &disturbance);
        fallback::lqr(&self.mpc, &begin, &point, &main_target, &knowledge.last_command())
    }

    /// Input of the simple controller, for a robot that plans do not hold.
    pub(super) fn simple(&self, measured: &State, knowledge: &Knowledge) -> Velocity {
        let point = self.points.first().copied().unwrap_or_default();
        let last = knowledge.last_command();
        fallback::simple(&self.mpc, knowledge.main(), &measured.pose, &point, &last)
    }

    /// Input that brakes to standstill, as fast as inputs may change.
    pub(super) fn braking(&self, knowledge: &Knowledge) -> Velocity {
        self.mpc.limits().brake(&knowledge.last_command())
    }
}

/// The part of `points` that can still be changed. It begins where the inputs under way end.
fn planned<'a>(points: &'a [ReferencePoint], knowledge: &Knowledge) -> &'a [ReferencePoint] {
    points.get(knowledge.delay().whole()..).unwrap_or(points)
}
