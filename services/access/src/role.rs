//! The roles that a certificate can name.

use std::fmt;

/// Role of a certificate's holder.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// The machine of that name in the graph file: its bridge and its gateway.
    Host(String),
    /// A robot's driver outside the graph, which connects to a bridge.
    Driver,
    /// Reads telemetry from anywhere.
    Watcher,
    /// A person who gives goals, and stops and arms the robot, from anywhere.
    Operator,
    /// A program that gives goals and lists of obstacles from anywhere.
    Planner,
}

/// The roles that are not hosts.
pub const CLIENTS: [Role; 4] = [Role::Driver, Role::Watcher, Role::Operator, Role::Planner];

/// Behind the name of a host, in certificates.
const HOST: &str = "-host";

impl Role {
    /// The role of that name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "driver" => Some(Self::Driver),
            "watcher" => Some(Self::Watcher),
            "operator" => Some(Self::Operator),
            "planner" => Some(Self::Planner),
            _ => {
                let host = name.strip_suffix(HOST).filter(|host| !host.is_empty())?;
                Some(Self::Host(host.to_owned()))
            }
        }
    }

    /// Subject of a certificate for this role of `robot`.
    pub fn subject(&self, robot: &str) -> String {
        format!("{self}.{robot}")
    }

    /// Whether other processes connect to it.
    pub const fn serves(&self) -> bool {
        matches!(self, Self::Host(_))
    }
}

/// The name in certificates, and of the folder that holds one.
impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Host(host) => write!(f, "{host}{HOST}"),
            Self::Driver => f.write_str("driver"),
            Self::Watcher => f.write_str("watcher"),
            Self::Operator => f.write_str("operator"),
            Self::Planner => f.write_str("planner"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_role_is_found_by_its_name() {
        for role in CLIENTS.into_iter().chain([Role::Host("control".to_owned())]) {
            assert_eq!(Role::named(&role.to_string()), Some(role));
        }
        assert_eq!([Role::named("root"), Role::named("-host")], [None, None]);
    }

    #[test]
    fn a_subject_names_role_and_robot() {
        assert_eq!(Role::Host("control".to_owned()).subject("mecanum"), "control-host.mecanum");
    }
}
