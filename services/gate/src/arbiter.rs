//! Which fallback level acts: a pure function of flags and time.

use crate::machine::Machine;
use protocol::message::{FallbackLevel, GateState, Reason};

/// Periods without an accepted command after which the robot brakes.
pub const BRAKE_FROM_PERIODS: u64 = 3;
/// Good periods that it takes to leave the brake.
pub const RECOVERY_PERIODS: u32 = 3;

/// All inputs of the decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Situation {
    /// Whether commands may drive the wheels.
    pub machine: Machine,
    /// Fallback level and age of the last accepted command; `None` before the first.
    pub accepted: Option<Accepted>,
    /// The robot has braked, and there were not enough good periods since.
    pub braking: bool,
}

/// The last accepted command, as far as the decision uses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Accepted {
    /// Fallback level that its controller stood on.
    pub fallback_level: FallbackLevel,
    /// Whole periods since the answered state.
    pub age_periods: u64,
    /// Length of its tail \[periods\].
    pub tail: u64,
}

/// Source of the input of the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// None: the wheels stand still.
    Stand,
    /// The input of the last accepted command.
    Command,
    /// An entry of its tail, from 0.
    Tail(usize),
    /// The ramp to standstill.
    Brake,
}

/// Decides. Total: every situation has a result.
pub fn decide(situation: &Situation) -> (Choice, FallbackLevel, Reason) {
    match situation.machine.state() {
        GateState::Stopped => {
            return (Choice::Brake, FallbackLevel::LatchedStop, situation.machine.stop_reason());
        }
        GateState::Disarmed => return (Choice::Stand, FallbackLevel::Waiting, Reason::Disarmed),
        GateState::Armed | GateState::Driving => {}
    }
    let Some(accepted) = situation.accepted else {
        return (Choice::Stand, FallbackLevel::Waiting, Reason::NoCommandYet);
    };
    if accepted.age_periods >= BRAKE_FROM_PERIODS || accepted.age_periods > accepted.tail {
        return (Choice::Brake, FallbackLevel::Brake, Reason::Missing);
    }
    if situation.braking {
        return (Choice::Brake, FallbackLevel::Brake, Reason::Recovering);
    }
    match accepted.age_periods {
        0 => (Choice::Command, accepted.fallback_level, own_reason(accepted.fallback_level)),
        age => (Choice::Tail(age as usize - 1), FallbackLevel::StoredTail, Reason::Missing),
    }
}

/// Reason of a controller for this fallback level. It leaves the fresh plan when its optimiser
/// fails, and brakes without a valid state.
pub(crate) fn own_reason(fallback_level: FallbackLevel) -> Reason {
    match fallback_level {
        FallbackLevel::Waiting | FallbackLevel::FreshPlan => Reason::None,
        FallbackLevel::ShiftedPlan | FallbackLevel::StoredTail => Reason::SolverFailed,
        FallbackLevel::Simple => Reason::NoPlan,
        FallbackLevel::Brake | FallbackLevel::LatchedStop => Reason::BadState,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All distinguishable situations.
    fn every_situation() -> impl Iterator<Item = Situation> {
        let accepted = FallbackLevel::ALL.iter().flat_map(|&fallback_level| {
            (0..6).flat_map(move |age_periods| {
                (0..5).map(move |tail| Some(Accepted { fallback_level, age_periods, tail }))
            })
        });
        accepted.chain(std::iter::once(None)).flat_map(|accepted| {
            let mut stopped = Machine::armed();
            stopped.stop(Reason::PositionError);
            [Machine::armed(), stopped, Machine::disarmed()].into_iter().flat_map(move |machine| {
                [false, true].map(|braking| Situation { machine, accepted, braking })
            })
        })
    }

    fn is(situation: &Situation, state: GateState) -> bool {
        situation.machine.state() == state
    }

    #[test]
    fn after_three_periods_only_the_brake_acts() {
        for situation in every_situation() {
            if situation.accepted.is_some_and(|accepted| accepted.age_periods >= 3) {
                let still =
                    if is(&situation, GateState::Disarmed) { Choice::Stand } else { Choice::Brake };
                assert_eq!(decide(&situation).0, still, "{situation:?}");
            }
        }
    }

    #[test]
    fn a_tail_is_never_played_beyond_its_end() {
        for situation in every_situation() {
            if let (Choice::Tail(index), Some(accepted)) =
                (decide(&situation).0, situation.accepted)
            {
                assert!((index as u64) < accepted.tail, "{situation:?}");
            }
        }
    }

    #[test]
    fn the_brake_continues_until_the_recovery_and_a_command_acts_in_its_own_period() {
        for situation in every_situation().filter(|situation| is(situation, GateState::Armed)) {
            let Some(accepted) = situation.accepted else { continue };
            let (choice, fallback_level, _) = decide(&situation);
            if situation.braking {
                assert_eq!(
                    (choice, fallback_level),
                    (Choice::Brake, FallbackLevel::Brake),
                    "{situation:?}"
                );
            } else if accepted.age_periods == 0 {
                assert_eq!(
                    (choice, fallback_level),
                    (Choice::Command, accepted.fallback_level),
                    "{situation:?}"
                );
            } else if accepted.age_periods <= accepted.tail
                && accepted.age_periods < BRAKE_FROM_PERIODS
            {
                assert_eq!(
                    (choice, fallback_level),
                    (Choice::Tail(accepted.age_periods as usize - 1), FallbackLevel::StoredTail),
                    "{situation:?}"
                );
            }
        }
    }

    #[test]
    fn before_the_first_command_the_wheels_stand_still() {
        for situation in
            every_situation().filter(|at| at.accepted.is_none() && !is(at, GateState::Stopped))
        {
            assert_eq!(decide(&situation).0, Choice::Stand, "{situation:?}");
        }
    }

    #[test]
    fn neither_a_stopped_nor_a_disarmed_gate_drives() {
        for situation in every_situation() {
            let decided = decide(&situation);
            match situation.machine.state() {
                GateState::Stopped => {
                    let expected =
                        (Choice::Brake, FallbackLevel::LatchedStop, Reason::PositionError);
                    assert_eq!(decided, expected, "{situation:?}");
                }
                GateState::Disarmed => {
                    let expected = (Choice::Stand, FallbackLevel::Waiting, Reason::Disarmed);
                    assert_eq!(decided, expected, "{situation:?}");
                }
                GateState::Armed | GateState::Driving => {}
            }
        }
    }

    #[test]
    fn every_fallback_level_except_the_fresh_plan_has_a_reason() {
        for situation in every_situation() {
            let (_, fallback_level, reason) = decide(&situation);
            let unexplained = fallback_level == FallbackLevel::FreshPlan;
            let echoes_the_controller = situation
                .accepted
                .is_some_and(|accepted| accepted.fallback_level == fallback_level);
            assert!(
                unexplained || echoes_the_controller || reason != Reason::None,
                "{situation:?} gives {fallback_level} without a reason"
            );
        }
    }
}
