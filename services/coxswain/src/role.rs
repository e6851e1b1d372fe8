//! Which processes there are, and in which order they start and end.

use protocol::message::Participant;

/// Who listens starts before who talks, so that nothing is missed.
pub const START_ORDER: [Participant; 5] = [
    Participant::Recorder,
    Participant::Gateway,
    Participant::Learner,
    Participant::Controller,
    Participant::Plant,
];

/// The robot comes to rest first; the recorder sees the others go. Those of one row end together.
pub const END_ORDER: [&[Participant]; 3] = [
    &[Participant::Plant],
    &[Participant::Controller, Participant::Learner, Participant::Gateway],
    &[Participant::Recorder],
];

/// Name of the binary that plays `role`.
pub const fn program(role: Participant) -> &'static str {
    match role {
        Participant::Plant => "plant-sim",
        _ => role.text(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_started_is_ended() {
        let mut ended: Vec<Participant> = END_ORDER.concat();
        ended.sort_unstable();
        let mut started = START_ORDER.to_vec();
        started.sort_unstable();
        assert_eq!(started, ended);
    }

    #[test]
    fn the_plant_starts_last_and_the_recorder_ends_last() {
        assert_eq!(START_ORDER.last(), Some(&Participant::Plant));
        assert_eq!(END_ORDER.concat().last(), Some(&Participant::Recorder));
    }
}
