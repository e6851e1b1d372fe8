//! A measured state → the input, its fallback level and reason.

use super::{Controller, Decision};
use crate::settings::Method;
use model::State;
use protocol::message::{FallbackLevel, Reason};

impl Controller {
    /// The command by plan, by the simple controller where plans do not hold the robot, or by the
    /// LQR where there is no plan.
    pub(super) fn decide(&mut self, measured: &State) -> Decision {
        if self.method == Method::FeedforwardP {
            return Decision {
                fallback_level: FallbackLevel::FreshPlan,
                reason: Reason::None,
                input: self.planner.simple(measured, &self.knowledge),
                solved: None,
            };
        }
        let solved = self.planner.plan(measured, &mut self.knowledge);
        if self.guard.prefers_simple() {
            self.guard.choice.look(solved.outcome);
            return Decision {
                fallback_level: FallbackLevel::Simple,
                reason: Reason::NoPlan,
                input: self.planner.simple(measured, &self.knowledge),
                solved: Some(solved),
            };
        }
        let (fallback_level, input) = self
            .guard
            .choice
            .choose(solved.outcome, &self.planner.mpc, &self.knowledge.last_command())
            .unwrap_or_else(|| {
                (FallbackLevel::Simple, self.planner.lqr(measured, &self.knowledge))
            });
        let reason = if fallback_level == FallbackLevel::FreshPlan {
            Reason::None
        } else {
            Reason::SolverFailed
        };
        Decision { fallback_level, reason, input, solved: Some(solved) }
    }

    /// Drops a plan that the gate would refuse, and answers with the LQR. If the gate would refuse
    /// that too, the robot brakes.
    pub(super) fn next_fallback_level(
        &mut self,
        from: FallbackLevel,
        reason: Reason,
        measured: &State,
    ) -> Decision {
        self.planner.drop_plan();
        self.guard.choice.reset();
        if from == FallbackLevel::Simple {
            return self.brake(reason);
        }
        Decision {
            fallback_level: FallbackLevel::Simple,
            reason,
            input: self.planner.lqr(measured, &self.knowledge),
            solved: None,
        }
    }

    /// Brakes to standstill.
    pub(super) fn brake(&self, reason: Reason) -> Decision {
        Decision {
            fallback_level: FallbackLevel::Brake,
            reason,
            input: self.planner.braking(&self.knowledge),
            solved: None,
        }
    }
}
