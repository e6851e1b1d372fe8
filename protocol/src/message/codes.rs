//! The coded fields of messages: an enum in the program, a `u32` on the wire.

use serde::{Deserialize, Serialize};

/// A coded field holds a number that no variant has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{code} is not a code of {of}")]
pub struct UnknownCode {
    /// The enum.
    pub of: &'static str,
    /// The number that was found.
    pub code: u32,
}

/// An enum whose variants are the codes of a field: 0, 1, 2 and so on.
pub trait Coded: Copy + TryFrom<u32, Error = UnknownCode> + 'static {
    /// Text of each variant for a person, in the order of its code.
    const WORDS: &'static [&'static str];

    /// The text of a code; "?" for one that no variant has, which no valid message carries.
    fn word(code: u32) -> &'static str {
        Self::WORDS.get(code as usize).copied().unwrap_or("?")
    }

    /// The variant with this text.
    fn of_word(word: &str) -> Option<Self> {
        let code = Self::WORDS.iter().position(|known| *known == word)?;
        Self::try_from(code as u32).ok()
    }
}

macro_rules! coded {
    ($(#[$meta:meta])* $name:ident {
        $($(#[$doc:meta])* $variant:ident = $code:literal => $text:literal,)+
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $name { $($(#[$doc])* $variant = $code,)+ }

        impl $name {
            /// Every variant, in the order of its code.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// The number on the wire.
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// Text for a person.
            pub const fn text(self) -> &'static str {
                match self { $(Self::$variant => $text,)+ }
            }
        }

        impl Coded for $name {
            const WORDS: &'static [&'static str] = &[$($text,)+];
        }

        impl TryFrom<u32> for $name {
            type Error = UnknownCode;

            fn try_from(code: u32) -> Result<Self, UnknownCode> {
                match code {
                    $($code => Ok(Self::$variant),)+
                    _ => Err(UnknownCode { of: stringify!($name), code }),
                }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.text())
            }
        }
    };
}

coded! {
    /// Source of an input, in the order of last resort. A greater fallback level is worse.
    FallbackLevel {
        /// The gate has not yet seen a valid command: the wheels stand.
        Waiting = 0 => "waiting",
        /// The optimiser's answer to the newest state.
        FreshPlan = 1 => "fresh plan",
        /// The previous plan, shifted by one period.
        ShiftedPlan = 2 => "shifted plan",
        /// The controller without a plan: input of the main model, with feedback of the error.
        Simple = 3 => "simple controller",
        /// The stored tail of the last accepted command, played by the gate.
        StoredTail = 4 => "stored tail",
        /// A ramp to standstill, by the gate.
        Brake = 5 => "brake",
        /// Standing still until a person resumes the plant, or starts it again.
        LatchedStop = 6 => "latched stop",
    }
}

coded! {
    /// Why a fallback level was taken, why the gate refused the last command, or why it has
    /// stopped.
    Reason {
        /// No reason to give.
        None = 0 => "-",
        /// No command has been accepted yet.
        NoCommandYet = 1 => "no command yet",
        /// No acceptable command came in time.
        Missing = 2 => "command missing",
        /// Version, kind, length, checksum or a code did not fit.
        Malformed = 3 => "malformed",
        /// A number was not finite.
        NotFinite = 4 => "not finite",
        /// An input was beyond what the wheels can do.
        OutOfBounds = 5 => "out of bounds",
        /// An input was too far from the input before it.
        TooFast = 6 => "rate too high",
        /// The command answered a state of another epoch of the plant.
        OldPlantEpoch = 7 => "old plant epoch",
        /// The controller of the command has been superseded.
        OldEpoch = 8 => "old controller epoch",
        /// A second controller with the same epoch.
        SecondWriter = 9 => "second writer",
        /// The state that the command answered is too old.
        TooOld = 10 => "too old",
        /// Not newer than the command before it.
        NotNewer = 11 => "not newer",
        /// The command answers a tick that has not begun yet.
        FromTheFuture = 12 => "from the future",
        /// The optimiser found no usable answer.
        SolverFailed = 13 => "solver failed",
        /// The robot's own measurement was not usable.
        BadState = 14 => "bad state",
        /// The controller received a request to stop.
        Stopping = 15 => "stopping",
        /// Leaving the brake: not enough good periods yet.
        Recovering = 16 => "recovering",
        /// The robot was farther from its reference than `limits.tracking_error_m`.
        PositionError = 17 => "position error",
        /// Its heading was farther from its reference than `limits.tracking_error_heading_rad`.
        HeadingError = 18 => "heading error",
        /// The robot's own emergency stop is pressed.
        EmergencyStop = 19 => "emergency stop",
        /// The gate waits for a person to arm it.
        Disarmed = 20 => "disarmed",
        /// The optimiser found no plan, or its plans track worse than the simple controller would.
        NoPlan = 21 => "no plan that holds",
        /// An operator has ordered the stop.
        OperatorStop = 22 => "operator stop",
        /// The gate has slowed the robot before an obstacle.
        ProtectiveStop = 23 => "protective stop",
        /// The gate has slowed the robot because it does not know the obstacles any more.
        ObstaclesUnknown = 24 => "obstacles unknown",
        /// The gate has slowed the robot to the limit of a zone.
        SpeedZone = 25 => "speed zone",
        /// The gate has slowed the robot before the border of its area.
        Geofence = 26 => "geofence",
    }
}

coded! {
    /// State of the plant's gate.
    GateState {
        /// The wheels stand until a person arms the gate.
        Disarmed = 0 => "disarmed",
        /// The next accepted command may drive the wheels.
        Armed = 1 => "armed",
        /// Accepted commands drive the wheels.
        Driving = 2 => "driving",
        /// Braked to a standstill, latched until a person resumes.
        Stopped = 3 => "stopped",
    }
}

coded! {
    /// What a goal demands.
    GoalKind {
        /// To stand where the robot is.
        Hold = 0 => "hold",
        /// To drive to a pose.
        Pose = 1 => "pose",
        /// To drive along a path.
        Path = 2 => "path",
        /// To drive with a body velocity for a time.
        Velocity = 3 => "velocity",
    }
}

coded! {
    /// How far a goal is.
    GoalPhase {
        /// The robot is on its way.
        Active = 0 => "active",
        /// The robot stands at the end of the goal.
        Reached = 1 => "reached",
        /// A later goal has taken its place.
        Preempted = 2 => "preempted",
        /// The plant has restarted: the robot stands where it is.
        Aborted = 3 => "aborted",
    }
}

coded! {
    /// Where a list of obstacles comes from.
    ObstacleSource {
        /// The robot's own sensors.
        Robot = 0 => "robot",
        /// A planner beside it.
        Planner = 1 => "planner",
    }
}

impl Reason {
    /// Codes with which a controller may request a stop of the gate, and that of no request.
    pub const STOP_REQUESTS: &'static [u32] =
        &[Self::None.code(), Self::PositionError.code(), Self::HeadingError.code()];

    /// Whether the gate has slowed the robot: the wheels have not got what the controller gave.
    pub const fn is_slowed(self) -> bool {
        matches!(
            self,
            Self::ProtectiveStop | Self::ObstaclesUnknown | Self::SpeedZone | Self::Geofence
        )
    }

    /// Whether a controller may request a stop of the gate for this reason.
    pub const fn is_stop_request(self) -> bool {
        matches!(self, Self::PositionError | Self::HeadingError)
    }
}

coded! {
    /// A process of the graph.
    Participant {
        /// The simulator, or a robot's driver.
        Plant = 0 => "plant",
        /// The model predictive controller.
        Controller = 1 => "controller",
        /// The Gaussian-process learner.
        Learner = 2 => "learner",
        /// Writes the record.
        Recorder = 3 => "recorder",
        /// Remote telemetry.
        Gateway = 4 => "gateway",
        /// Carries messages between this host and others.
        Bridge = 5 => "bridge",
    }
}

coded! {
    /// Progress of a process from its start to its end.
    Phase {
        /// Opening its ports.
        Starting = 0 => "starting",
        /// All ports open, waiting for the first message.
        Ready = 1 => "ready",
        /// At work.
        Running = 2 => "running",
        /// At work, with something missing.
        Degraded = 3 => "degraded",
        /// Its task is complete.
        Finished = 4 => "finished",
    }
}

coded! {
    /// What unauthenticated peers on the network can do to a graph, because a person has allowed it
    /// (`--insecure`). A greater one is worse.
    Exposure {
        /// Nothing, as far as the reporting process knows.
        Closed = 0 => "closed",
        /// Watch the robot.
        Watched = 1 => "strangers can watch",
        /// Command the robot.
        Driven = 2 => "strangers can drive",
    }
}

coded! {
    /// Result that the optimiser reports.
    SolverStatus {
        /// No problem was solved in this period.
        NotRun = 0 => "not run",
        /// Optimal within tolerance.
        Solved = 1 => "solved",
        /// Optimal within a relaxed tolerance.
        AlmostSolved = 2 => "almost solved",
        /// Out of iterations.
        OutOfIterations = 3 => "out of iterations",
        /// No input satisfies the limits.
        Infeasible = 4 => "infeasible",
        /// Numerical trouble.
        NumericalError = 5 => "numerical error",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_comes_back_as_the_variant_that_it_was() {
        for (code, &level) in FallbackLevel::ALL.iter().enumerate() {
            assert_eq!(
                (level.code() as usize, FallbackLevel::word(level.code())),
                (code, level.text())
            );
            assert_eq!(FallbackLevel::try_from(level.code()), Ok(level));
            assert_eq!(FallbackLevel::of_word(level.text()), Some(level));
        }
        for (code, &reason) in Reason::ALL.iter().enumerate() {
            assert_eq!(
                (reason.code() as usize, Reason::word(reason.code())),
                (code, reason.text())
            );
            assert_eq!(Reason::try_from(reason.code()), Ok(reason));
            assert_eq!(Reason::of_word(reason.text()), Some(reason));
        }
        assert_eq!(FallbackLevel::try_from(99), Err(UnknownCode { of: "FallbackLevel", code: 99 }));
    }

    #[test]
    fn a_worse_fallback_level_is_a_greater_one() {
        assert!(FallbackLevel::ALL.is_sorted());
    }
}
