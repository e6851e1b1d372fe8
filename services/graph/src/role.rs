//! The processes, and the order in which they start and stop.

use protocol::message::Participant;

/// Subscribers start before publishers, so that no message is missed.
pub const START_ORDER: [Participant; 6] = [
    Participant::Recorder,
    Participant::Gateway,
    Participant::Bridge,
    Participant::Learner,
    Participant::Controller,
    Participant::Plant,
];

/// The robot comes to rest first. The bridge tells other hosts of the end, and the recorder records
/// it. The processes of one group stop together.
pub const END_ORDER: [&[Participant]; 4] = [
    &[Participant::Plant],
    &[Participant::Controller, Participant::Learner, Participant::Gateway],
    &[Participant::Bridge],
    &[Participant::Recorder],
];

/// Name of the binary of `role`.
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
    fn every_started_role_is_stopped() {
        let mut ended: Vec<Participant> = END_ORDER.concat();
        ended.sort_unstable();
        let mut started = START_ORDER.to_vec();
        started.sort_unstable();
        assert_eq!(started, ended);
    }

    #[test]
    fn the_plant_starts_last_and_the_recorder_stops_last() {
        assert_eq!(START_ORDER.last(), Some(&Participant::Plant));
        assert_eq!(END_ORDER.concat().last(), Some(&Participant::Recorder));
    }
}
