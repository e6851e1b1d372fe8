//! code ↔ word: a record shows coded fields as words for a person.

use crate::message::{
    Exposure, FallbackLevel, GateState, Participant, Phase, Reason, SolverStatus,
};

/// Lists the words of one kind of code.
pub type Words = fn() -> Vec<&'static str>;

/// Words of [`FallbackLevel`].
pub fn fallback_levels() -> Vec<&'static str> {
    FallbackLevel::ALL.iter().map(|fallback_level| fallback_level.text()).collect()
}

/// Words of [`Reason`].
pub fn reasons() -> Vec<&'static str> {
    Reason::ALL.iter().map(|reason| reason.text()).collect()
}

/// Words of [`GateState`].
pub fn gate_states() -> Vec<&'static str> {
    GateState::ALL.iter().map(|state| state.text()).collect()
}

/// Words of [`SolverStatus`].
pub fn statuses() -> Vec<&'static str> {
    SolverStatus::ALL.iter().map(|status| status.text()).collect()
}

/// Words of [`Participant`].
pub fn participants() -> Vec<&'static str> {
    Participant::ALL.iter().map(|participant| participant.text()).collect()
}

/// Words of [`Phase`].
pub fn phases() -> Vec<&'static str> {
    Phase::ALL.iter().map(|phase| phase.text()).collect()
}

/// Words of [`Exposure`].
pub fn exposures() -> Vec<&'static str> {
    Exposure::ALL.iter().map(|exposure| exposure.text()).collect()
}

/// The fallback level of this name.
pub fn fallback_level(word: &str) -> Option<FallbackLevel> {
    FallbackLevel::ALL.iter().copied().find(|fallback_level| fallback_level.text() == word)
}

/// The reason of this name.
pub fn reason(word: &str) -> Option<Reason> {
    Reason::ALL.iter().copied().find(|reason| reason.text() == word)
}

/// The exposure of this name.
pub fn exposure(word: &str) -> Option<Exposure> {
    Exposure::ALL.iter().copied().find(|exposure| exposure.text() == word)
}

/// The word of a fallback level's code; "?" for a code of another version, which no valid message
/// carries.
pub fn of_fallback_level(code: u32) -> &'static str {
    FallbackLevel::try_from(code).map_or("?", FallbackLevel::text)
}

/// The word of a reason's code; "?" as for [`of_fallback_level`].
pub fn of_reason(code: u32) -> &'static str {
    Reason::try_from(code).map_or("?", Reason::text)
}
