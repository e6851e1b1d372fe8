//! The roles that a certificate can name.

use crate::message::Participant;
use crate::topic::Topic;

/// Whom a certificate says that its holder is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// The robot's driver, or the simulator.
    Robot,
    /// The model predictive controller.
    Controller,
    /// The Gaussian-process learner.
    Learner,
    /// Writes the record.
    Recorder,
    /// Shows the robot to watchers.
    Gateway,
    /// Looks on from anywhere.
    Watcher,
    /// The launch on the robot's machine.
    RobotHost,
    /// The launch on the controller's machine.
    ControlHost,
}

impl Role {
    /// Every role.
    pub const ALL: [Self; 8] = [
        Self::Robot,
        Self::Controller,
        Self::Learner,
        Self::Recorder,
        Self::Gateway,
        Self::Watcher,
        Self::RobotHost,
        Self::ControlHost,
    ];

    /// Name in certificates, and of the folder that holds one.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Controller => "controller",
            Self::Learner => "learner",
            Self::Recorder => "recorder",
            Self::Gateway => "gateway",
            Self::Watcher => "watcher",
            Self::RobotHost => "robot-host",
            Self::ControlHost => "control-host",
        }
    }

    /// The role of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }

    /// What a certificate for this role of `robot` says in its subject.
    pub fn subject(self, robot: &str) -> String {
        format!("{}.{robot}", self.name())
    }

    /// Whether others connect to it.
    pub const fn serves(self) -> bool {
        matches!(self, Self::Gateway | Self::RobotHost | Self::ControlHost)
    }

    /// Whether it is a launch's router, which passes on what the processes of its machine say.
    pub const fn is_host(self) -> bool {
        matches!(self, Self::RobotHost | Self::ControlHost)
    }

    /// Topics that it writes.
    pub const fn says(self) -> &'static [Topic] {
        use Topic::{Command, Credit, Health, Plan, Residual, Snapshot, State, Truth};
        match self {
            Self::Robot => &[State, Truth, Health],
            Self::Controller => &[Command, Residual, Plan, Health],
            Self::Learner => &[Snapshot, Health],
            Self::Recorder => &[Credit, Health],
            Self::Gateway => &[Health],
            Self::Watcher => &[],
            Self::RobotHost => &[State, Truth, Credit, Health],
            Self::ControlHost => &[Command, Residual, Snapshot, Plan, Credit, Health],
        }
    }

    /// Whose messages on `topic` it brings, which it says: its own and, of a host, those of the processes of its machine.
    pub fn brings(self, topic: Topic) -> Vec<Self> {
        let is_here = |role: &Self| {
            self.is_host()
                && !role.is_host()
                && role.says().iter().all(|topic| self.says().contains(topic))
        };
        Self::ALL
            .into_iter()
            .filter(|role| role.says().contains(&topic) && (*role == self || is_here(role)))
            .collect()
    }

    /// Whether roles that are no hosts share `topic`.
    pub(crate) fn share(topic: Topic) -> bool {
        Self::ALL.iter().filter(|role| !role.is_host() && role.says().contains(&topic)).count() > 1
    }

    /// Topics that it reads.
    #[expect(clippy::match_same_arms, reason = "a table, one row per role")]
    pub const fn hears(self) -> &'static [Topic] {
        use Topic::{Command, Credit, Health, Plan, Residual, Snapshot, State, Truth};
        match self {
            Self::Robot => &[Command, Credit],
            Self::Controller => &[State, Snapshot],
            Self::Learner => &[Residual],
            Self::Recorder => &[State, Command, Residual, Snapshot, Plan, Health, Truth],
            Self::Gateway => &[State, Residual, Snapshot, Plan, Health, Truth],
            Self::Watcher => &[],
            Self::RobotHost => &[Command, Residual, Snapshot, Plan, Health],
            Self::ControlHost => &[State, Residual, Snapshot, Plan, Health, Truth],
        }
    }
}

impl From<Participant> for Role {
    fn from(participant: Participant) -> Self {
        match participant {
            Participant::Plant => Self::Robot,
            Participant::Controller => Self::Controller,
            Participant::Learner => Self::Learner,
            Participant::Recorder => Self::Recorder,
            Participant::Gateway => Self::Gateway,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn who_says(topic: Topic) -> Vec<Role> {
        Role::ALL
            .into_iter()
            .filter(|role| !role.is_host() && role.says().contains(&topic))
            .collect()
    }

    #[test]
    fn what_moves_the_robot_has_one_writer() {
        assert_eq!(who_says(Topic::State), [Role::Robot]);
        assert_eq!(who_says(Topic::Command), [Role::Controller]);
        assert_eq!(who_says(Topic::Residual), [Role::Controller]);
        assert_eq!(who_says(Topic::Snapshot), [Role::Learner]);
    }

    #[test]
    fn a_host_never_says_what_the_other_machine_says() {
        let [robot, control] = [Role::RobotHost, Role::ControlHost].map(Role::says);
        assert!(
            [Topic::State, Topic::Truth]
                .iter()
                .all(|topic| robot.contains(topic) && !control.contains(topic))
        );
        assert!(
            [Topic::Command, Topic::Residual, Topic::Snapshot]
                .iter()
                .all(|topic| control.contains(topic) && !robot.contains(topic))
        );
    }

    #[test]
    fn a_host_brings_what_its_own_machine_says_and_everybody_else_what_he_says_himself() {
        assert_eq!(Role::RobotHost.brings(Topic::State), [Role::Robot, Role::RobotHost]);
        assert_eq!(
            Role::RobotHost.brings(Topic::Health),
            [Role::Robot, Role::Recorder, Role::Gateway, Role::RobotHost]
        );
        assert_eq!(Role::ControlHost.brings(Topic::Command), [Role::Controller, Role::ControlHost]);
        let all =
            [Role::Controller, Role::Learner, Role::Recorder, Role::Gateway, Role::ControlHost];
        assert_eq!(Role::ControlHost.brings(Topic::Health), all);
        for role in Role::ALL.into_iter().filter(|role| !role.is_host()) {
            assert!(role.says().iter().all(|topic| role.brings(*topic) == [role]), "{role:?}");
        }
    }

    #[test]
    fn only_heartbeats_are_of_several_roles() {
        let shared: Vec<Topic> =
            Topic::ALL.into_iter().filter(|topic| Role::share(*topic)).collect();
        assert_eq!(shared, [Topic::Health]);
    }

    #[test]
    fn a_role_is_found_by_its_name() {
        assert!(Role::ALL.into_iter().all(|role| Role::named(role.name()) == Some(role)));
        assert_eq!(
            (Role::named("root"), Role::Robot.subject("mecanum").as_str()),
            (None, "robot.mecanum")
        );
    }
}
