//! The graph file: which processes, which links, which robot and scenario.

use crate::back_off::RestartPolicy;
use gateway::settings::{Rates, check_telemetry};
use process::Pace;
use protocol::message::Participant;
use protocol::port::Carriers;
use protocol::telemetry::TelemetrySettings;
use protocol::topic::Topic;
use serde::Deserialize;
use settings::{Check, Impossible};
use std::path::PathBuf;
use std::time::Duration;

/// What a graph file holds.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    /// A person's name for it.
    pub name: String,
    /// Robot file, relative to the graph file.
    pub robot: PathBuf,
    /// Scenario file, relative to the graph file.
    pub scenario: PathBuf,
    /// Whose time it is.
    pub pace: Pace,
    /// In lock step: how long a writer waits for a reader that makes no room, before it gives up \[ms\].
    #[serde(default = "lock_step_patience_millis")]
    pub lock_step_patience_millis: u64,
    /// What each link runs over: `default`, or the name of a topic.
    pub links: Carriers,
    /// Where the gateway listens for watchers, and how the robot is called.
    #[serde(default)]
    pub telemetry: TelemetrySettings,
    /// How often the gateway shows each topic \[Hz\].
    #[serde(default)]
    pub rates: Rates,
    /// Its processes.
    #[serde(default)]
    pub processes: Processes,
}

fn lock_step_patience_millis() -> u64 {
    10_000
}

/// How each process is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Processes {
    /// The simulator.
    pub plant: Treatment,
    /// The model predictive controller.
    pub controller: Treatment,
    /// The Gaussian-process learner.
    pub learner: Treatment,
    /// Writes the record.
    pub recorder: Treatment,
    /// Shows the robot to watchers; of all processes the only one that is not started unless the graph says so.
    pub gateway: Treatment,
}

impl Default for Processes {
    fn default() -> Self {
        let started = Treatment::default();
        let gateway = Treatment { enabled: false, ..started };
        Self { plant: started, controller: started, learner: started, recorder: started, gateway }
    }
}

/// How one process is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Treatment {
    /// Whether it is started at all.
    pub enabled: bool,
    /// Most restarts within a minute; one more death ends the run.
    pub restarts_per_minute: u32,
    /// Wait before the second restart within a minute, doubled with each further one \[ms\]. The first has no wait.
    pub back_off_millis: u64,
    /// Longest wait before a restart \[ms\].
    pub back_off_max_millis: u64,
}

impl Default for Treatment {
    fn default() -> Self {
        Self { enabled: true, restarts_per_minute: 10, back_off_millis: 100, back_off_max_millis: 2000 }
    }
}

impl Treatment {
    /// When it is started again.
    pub fn restart_policy(&self) -> RestartPolicy {
        RestartPolicy {
            per_minute: self.restarts_per_minute,
            second: Duration::from_millis(self.back_off_millis),
            longest: Duration::from_millis(self.back_off_max_millis),
        }
    }
}

impl Processes {
    /// How `role` is treated.
    pub fn of(&self, role: Participant) -> Treatment {
        match role {
            Participant::Plant => self.plant,
            Participant::Controller => self.controller,
            Participant::Learner => self.learner,
            Participant::Recorder => self.recorder,
            Participant::Gateway => self.gateway,
        }
    }
}

impl Check for Graph {
    fn check(&self) -> Result<(), Impossible> {
        for link in self.links.exceptions.keys() {
            if !Topic::ALL.iter().any(|topic| topic.name() == link) {
                let topics = Topic::ALL.map(Topic::name).join(", ");
                return Err(Impossible::new(format!("links.{link}"), format!("default or a topic for the name of a link: {topics}")));
            }
        }
        if self.lock_step_patience_millis == 0 {
            return Err(Impossible::new("lock_step_patience_millis", "at least 1 ms"));
        }
        check_telemetry(&self.telemetry).map_err(|impossible| impossible.under("telemetry"))?;
        self.rates.check().map_err(|impossible| impossible.under("rates"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const GOOD: &str =
        "name = \"g\"\nrobot = \"r.toml\"\nscenario = \"s.toml\"\npace = \"real-time\"\n[links]\ndefault = \"shared-memory\"\n";

    fn refusal(text: &str) -> Option<String> {
        settings::parse::<Graph>(text, Path::new("g.toml")).err().map(|error| error.to_string())
    }

    #[test]
    fn a_graph_need_not_say_how_each_process_is_treated() {
        assert_eq!(refusal(GOOD), None);
        assert_eq!(refusal(&format!("{GOOD}state = \"shared-memory\"\n[processes.learner]\nenabled = false\n")), None);
    }

    #[test]
    fn a_link_that_is_no_topic_is_refused() {
        let topics = "state, command, residual, snapshot, plan, health, truth, credit";
        assert_eq!(
            refusal(&format!("{GOOD}stat = \"shared-memory\"\n")),
            Some(format!("g.toml:7: links.stat = \"shared-memory\": expected default or a topic for the name of a link: {topics}"))
        );
    }

    #[test]
    fn an_unknown_process_is_refused() {
        assert_eq!(
            refusal(&format!("{GOOD}[processes.lerner]\n")).as_deref(),
            Some("g.toml:7: processes.lerner = a table: unknown key, expected one of plant, controller, learner, recorder, gateway")
        );
    }
}
