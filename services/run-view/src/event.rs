//! What happened in a run, by type, and its text.

use protocol::message::{FallbackLevel, Goal, Health, Participant, Phase, Reason};
use serde::Serialize;
use std::fmt;

/// One event.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Number of the event in its run view, from 1.
    pub number: u64,
    /// Control period of the newest state.
    pub tick: u64,
    /// The process that it is about.
    pub who: Participant,
    /// What happened.
    pub what: What,
}

/// What happened to a process, or to the robot.
#[derive(Debug, Clone, PartialEq)]
pub enum What {
    /// A plant of another epoch began a new run.
    NewRun(u64),
    /// The fallback level changed, from one to the other, or only its cause if both are the same.
    Level(FallbackLevel, FallbackLevel, Reason),
    /// The gate refused a command.
    Refused(Reason),
    /// Another goal, or another phase of the same one.
    Goal(Goal),
    /// Another instance of the process, with its process id.
    Restarted(u32),
    /// The process went from one phase to the other.
    Phase(Phase, Phase),
    /// The process, in this phase, reports another error.
    Error(Phase, String),
    /// A counter of the process has grown by so much.
    Counted(Counter, u64),
    /// The process sends no messages.
    Silent,
    /// The process sends messages again.
    SendsAgain,
    /// The robot sends no states.
    Lost,
    /// The robot sends states again.
    Back,
    /// A change of settings was applied or refused.
    Change(String),
}

/// Weight of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Sort {
    /// A fault.
    Fault,
    /// The end of a fault.
    Mended,
    /// A change.
    Note,
    /// A change that is seen elsewhere, too.
    Detail,
}

/// A counter of Health whose growth is an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counter {
    /// Messages lost on the way to it.
    Lost,
    /// Malformed messages.
    Malformed,
    /// Periods without an answer in time.
    Missed,
    /// Learned models refused.
    SnapshotsRefused,
    /// Axes on which a learned model was dropped.
    ModelsLeft,
}

impl Counter {
    /// All counters.
    pub const ALL: [Self; 5] =
        [Self::Lost, Self::Malformed, Self::Missed, Self::SnapshotsRefused, Self::ModelsLeft];

    /// Its value in a Health.
    pub fn of(self, health: &Health) -> u64 {
        let sum = |counts: &[u64]| counts.iter().copied().fold(0, u64::saturating_add);
        match self {
            Self::Lost => sum(&health.lost),
            Self::Malformed => sum(&health.refused),
            Self::Missed => health.deadlines_missed,
            Self::SnapshotsRefused => health.snapshots_refused,
            Self::ModelsLeft => health.models_left,
        }
    }

    const fn text(self) -> &'static str {
        match self {
            Self::Lost => "messages lost on the way to it",
            Self::Malformed => "malformed messages refused",
            Self::Missed => "periods missed",
            Self::SnapshotsRefused => "learned models refused",
            Self::ModelsLeft => "axes where the learned model was dropped as worse than none",
        }
    }
}

impl What {
    /// Kind of the event, for programs, and its weight.
    pub fn kind(&self) -> (&'static str, Sort) {
        use Sort::{Detail, Fault, Mended, Note};
        match self {
            Self::NewRun(_) => ("new-run", Detail),
            Self::Level(from, to, _) if from == to => ("level", Detail),
            Self::Level(_, FallbackLevel::FreshPlan, _) => ("level", Mended),
            Self::Level(from, to, _) if from < to => ("level", Fault),
            Self::Level(..) => ("level", Note),
            Self::Refused(_) => ("refused", Fault),
            Self::Goal(_) => ("goal", Note),
            Self::Restarted(_) => ("restarted", Mended),
            Self::Phase(_, Phase::Degraded) => ("phase", Fault),
            Self::Phase(Phase::Degraded, Phase::Running) => ("phase", Mended),
            Self::Phase(_, Phase::Finished) => ("phase", Note),
            Self::Phase(..) => ("phase", Detail),
            Self::Error(Phase::Degraded, _) => ("error", Fault),
            Self::Error(..) => ("error", Note),
            Self::Counted(Counter::ModelsLeft, _) => ("counted", Note),
            Self::Counted(..) => ("counted", Fault),
            Self::Silent => ("silent", Fault),
            Self::SendsAgain => ("sends-again", Mended),
            Self::Lost => ("lost", Fault),
            Self::Back => ("back", Mended),
            Self::Change(_) => ("change", Note),
        }
    }
}

impl fmt::Display for What {
    /// The text beside the name of the process.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NewRun(epoch) => write!(f, "has restarted, epoch {epoch}"),
            Self::Level(from, to @ FallbackLevel::FreshPlan, _)
            | Self::Level(from, to, Reason::None) => write!(f, "{from} → {to}"),
            Self::Level(from, to, cause) => write!(f, "{from} → {to} ({cause})"),
            Self::Refused(reason) => write!(f, "the gate refused a command ({reason})"),
            Self::Goal(goal) => write!(f, "goal {} ({}): {}", goal.id, goal.kind(), goal.phase()),
            Self::Restarted(pid) => write!(f, "started again, as process {pid}"),
            Self::Phase(_, Phase::Degraded) => f.write_str("runs with something missing"),
            Self::Phase(Phase::Degraded, Phase::Running) => f.write_str("has recovered"),
            Self::Phase(_, Phase::Finished) => f.write_str("has finished"),
            Self::Phase(_, to) => write!(f, "is {to}"),
            Self::Counted(counter, more) => write!(f, "{}: {more}", counter.text()),
            Self::Silent => f.write_str("is silent"),
            Self::SendsAgain => f.write_str("sends messages again"),
            Self::Lost => f.write_str("lost: no message from the robot"),
            Self::Back => f.write_str("the robot is back"),
            Self::Error(_, text) | Self::Change(text) => f.write_str(text),
        }
    }
}
