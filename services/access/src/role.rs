//! The roles that a certificate can name.

use protocol::message::Participant;
use protocol::topic::Topic;

/// Role of a certificate's holder.
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
    /// The launch on the robot's machine: its router.
    RobotHost,
    /// The launch on the controller's machine: its router.
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

    /// Subject of a certificate for this role of `robot`.
    pub fn subject(self, robot: &str) -> String {
        format!("{}.{robot}", self.name())
    }

    /// Whether other processes connect to it.
    pub const fn serves(self) -> bool {
        matches!(self, Self::Gateway | Self::RobotHost | Self::ControlHost)
    }

    /// Whether it is a launch's router, which forwards the messages of the processes on its
    /// machine.
    pub const fn is_host(self) -> bool {
        matches!(self, Self::RobotHost | Self::ControlHost)
    }

    /// Topics that it publishes.
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

    /// Roles whose messages on `topic` this role delivers, given that it publishes the topic. These
    /// are its own and, for a host, those of the processes on its machine.
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

    /// Whether several roles that are not hosts publish `topic`.
    pub fn share(topic: Topic) -> bool {
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
    fn a_host_never_publishes_the_topics_of_the_other_machine() {
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
    fn a_host_delivers_the_messages_of_its_machine_and_any_other_role_its_own() {
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
    fn only_heartbeats_are_published_by_several_roles() {
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
