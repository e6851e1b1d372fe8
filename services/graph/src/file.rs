//! The graph file: which processes, on which hosts, which robot and scenario.

use crate::back_off::RestartPolicy;
use crate::certificates::CertificatesTable;
use crate::hosts::{Connection, Deployment, Host, ONLY_HOST, is_address};
use crate::role::START_ORDER;
use driver::LINK_DELAY_MILLIS_MAX;
use driver::piped::Program;
use gateway::settings::{PageSettings, Rates, check_telemetry};
use network::telemetry::TelemetrySettings;
use process::{Pace, Scheduling};
use protocol::message::Participant;
use serde::Deserialize;
use settings::{Check, Impossible};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use transport::is_graph_name;

/// Contents of a graph file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    /// Name of the graph.
    pub name: String,
    /// Robot file, relative to the graph file.
    pub robot: PathBuf,
    /// Scenario file, relative to the graph file.
    pub scenario: PathBuf,
    /// Source of the time.
    pub pace: Pace,
    /// Whether the gate of its plant starts armed. If not, the wheels do not move until `coxswain
    /// arm`.
    #[serde(default = "armed")]
    pub armed: bool,
    /// In lock step: time after which a writer gives up if a reader frees no space \[ms\].
    #[serde(default = "lock_step_patience_millis")]
    pub lock_step_patience_millis: u64,
    /// Its hosts. Without any, all processes run on this machine.
    #[serde(default)]
    pub hosts: BTreeMap<String, Host>,
    /// Where two hosts meet.
    #[serde(default)]
    pub connections: Vec<Connection>,
    /// Where operators and planners on other machines reach a host: host and port by the name of
    /// the host, which is `robot` in a graph without hosts. Needs certificates.
    #[serde(default)]
    pub requests: BTreeMap<String, String>,
    /// Settings of the network between the hosts.
    #[serde(default)]
    pub network: Network,
    /// Where the certificates are that authenticate its processes on the network. Without them
    /// nothing on the network is encrypted, and only addresses of this machine are used.
    #[serde(default)]
    pub certificates: Option<CertificatesTable>,
    /// Where the gateway listens for watchers, and the name of the robot.
    #[serde(default)]
    pub telemetry: TelemetrySettings,
    /// Rate at which the gateway publishes each topic \[Hz\].
    #[serde(default)]
    pub rates: Rates,
    /// Where the gateway serves the live page. Without this table it serves none.
    #[serde(default)]
    pub page: PageSettings,
    /// The program that drives the robot, in place of the simulator. A path is relative to the
    /// graph file; a name without a folder is that of a program beside `coxswain`.
    #[serde(default)]
    pub driver: Option<Program>,
    /// Its processes.
    #[serde(default)]
    pub processes: Processes,
}

/// Settings of the network between the hosts.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Network {
    /// Age, in addition to 1.5 periods, that the state of a command may have because of the delay
    /// of the network in both directions \[ms\].
    pub delay_millis: u64,
}

impl Network {
    fn check(&self) -> Result<(), Impossible> {
        if self.delay_millis > LINK_DELAY_MILLIS_MAX {
            return Err(Impossible::new(
                "delay_millis",
                format!("at most {LINK_DELAY_MILLIS_MAX} ms"),
            ));
        }
        Ok(())
    }
}

fn armed() -> bool {
    true
}

fn lock_step_patience_millis() -> u64 {
    10_000
}

/// Time without a heartbeat for processes that the robot needs \[ms\]: four heartbeats.
const NEEDED_HUNG_AFTER_MILLIS: u64 = 400;
/// Shortest such time \[ms\]: two heartbeats may be late.
const HUNG_AFTER_LEAST_MILLIS: u64 = 300;
/// Time without a heartbeat for other processes \[ms\].
const HUNG_AFTER_MILLIS: u64 = 2500;

/// Whether the robot cannot be driven without `role`.
pub fn is_needed(role: Participant) -> bool {
    matches!(role, Participant::Plant | Participant::Controller | Participant::Bridge)
}

/// Settings of each process.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
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
    /// Publishes telemetry for watchers. The only process that is not started unless the graph
    /// enables it.
    pub gateway: Treatment,
    /// Carries messages between hosts; started where the graph has hosts or accepts requests.
    pub bridge: Treatment,
}

impl Default for Processes {
    fn default() -> Self {
        let started = Treatment::default();
        let not_started = Treatment { enabled: false, ..started.clone() };
        Self {
            plant: started.clone(),
            controller: started.clone(),
            learner: started.clone(),
            recorder: started,
            gateway: not_started.clone(),
            bridge: not_started,
        }
    }
}

/// Settings of one process.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Treatment {
    /// Whether it is started.
    pub enabled: bool,
    /// Largest number of restarts within a minute. One more failure ends the run if the robot needs
    /// the process. Otherwise the run continues without it.
    pub restarts_per_minute: u32,
    /// Wait before the second restart within a minute, doubled for each further one \[ms\]. The
    /// first restart has no wait.
    pub back_off_millis: u64,
    /// Longest wait before a restart \[ms\].
    pub back_off_max_millis: u64,
    /// In real time: time without a heartbeat after which the process counts as hung and is killed
    /// \[ms\]. By default 400 for processes that the robot needs, and 2500 for others.
    pub hung_after_millis: Option<u64>,
    /// Scheduling settings for the operating system.
    pub scheduling: Scheduling,
}

impl Default for Treatment {
    fn default() -> Self {
        Self {
            enabled: true,
            restarts_per_minute: 10,
            back_off_millis: 100,
            back_off_max_millis: 2000,
            hung_after_millis: None,
            scheduling: Scheduling::default(),
        }
    }
}

impl Treatment {
    /// When it is restarted.
    pub fn restart_policy(&self) -> RestartPolicy {
        RestartPolicy {
            per_minute: self.restarts_per_minute,
            second: Duration::from_millis(self.back_off_millis),
            longest: Duration::from_millis(self.back_off_max_millis),
        }
    }
}

impl Processes {
    /// Time without a heartbeat after which the process of `role` counts as hung.
    pub fn hung_after(&self, role: Participant) -> Duration {
        let default = if is_needed(role) { NEEDED_HUNG_AFTER_MILLIS } else { HUNG_AFTER_MILLIS };
        Duration::from_millis(self.of(role).hung_after_millis.unwrap_or(default))
    }

    /// The same, to be changed.
    fn of_mut(&mut self, role: Participant) -> &mut Treatment {
        match role {
            Participant::Plant => &mut self.plant,
            Participant::Controller => &mut self.controller,
            Participant::Learner => &mut self.learner,
            Participant::Recorder => &mut self.recorder,
            Participant::Gateway => &mut self.gateway,
            Participant::Bridge => &mut self.bridge,
        }
    }

    /// Settings of `role`.
    pub fn of(&self, role: Participant) -> &Treatment {
        match role {
            Participant::Plant => &self.plant,
            Participant::Controller => &self.controller,
            Participant::Learner => &self.learner,
            Participant::Recorder => &self.recorder,
            Participant::Gateway => &self.gateway,
            Participant::Bridge => &self.bridge,
        }
    }
}

impl Graph {
    /// Its hosts and connections.
    pub fn deployment(&self) -> Deployment<'_> {
        Deployment { hosts: &self.hosts, connections: &self.connections }
    }

    /// Only the processes of `host` are started, and its bridge.
    pub fn keep_host(&mut self, host: &str) {
        let listed = self.hosts.get(host).map(Host::participants).unwrap_or_default();
        for role in START_ORDER {
            let treatment = self.processes.of_mut(role);
            let by_list = matches!(role, Participant::Gateway | Participant::Bridge);
            treatment.enabled = listed.contains(&role) && (treatment.enabled || by_list);
        }
        self.requests.retain(|name, _| name == host);
    }

    /// Each address for requests is that of a host with a process to request something of.
    fn check_requests(&self) -> Result<(), Impossible> {
        for (name, address) in &self.requests {
            let listens = if self.hosts.is_empty() {
                name == ONLY_HOST
            } else {
                self.hosts.get(name).is_some_and(|host| {
                    [Participant::Plant, Participant::Controller]
                        .iter()
                        .any(|role| host.processes.contains(role))
                })
            };
            if !listens {
                let expected = if self.hosts.is_empty() {
                    format!("the key {ONLY_HOST}: the graph has no hosts")
                } else {
                    "the name of a host with plant or controller".to_owned()
                };
                return Err(Impossible::new(name.clone(), expected));
            }
            if !is_address(address) {
                return Err(Impossible::new(
                    name.clone(),
                    "a host and a port such as 10.0.0.1:7451",
                ));
            }
        }
        Ok(())
    }
}

impl Check for Graph {
    fn check(&self) -> Result<(), Impossible> {
        self.deployment().check()?;
        let has_bridge = !self.hosts.is_empty() || !self.requests.is_empty();
        if has_bridge && !is_graph_name(&self.name) {
            let expected = "1 to 32 characters out of a-z, 0-9, _ and -: it is a part of all keys";
            return Err(Impossible::new("name", expected));
        }
        self.network.check().map_err(|impossible| impossible.under("network"))?;
        self.check_requests().map_err(|impossible| impossible.under("requests"))?;
        for role in START_ORDER {
            let treatment = self.processes.of(role);
            let key = |key: &str| format!("processes.{}.{key}", role.text());
            treatment
                .scheduling
                .check()
                .map_err(|impossible| impossible.under(&key("scheduling")))?;
            if treatment.scheduling.real_time_priority.is_some() && !is_needed(role) {
                let expected = "nothing: a command waits for plant, controller and bridge alone";
                return Err(Impossible::new(key("scheduling.real_time_priority"), expected));
            }
            if treatment.hung_after_millis.is_some_and(|millis| millis < HUNG_AFTER_LEAST_MILLIS) {
                let expected = format!(
                    "at least {HUNG_AFTER_LEAST_MILLIS} ms: a heartbeat comes every 100 ms"
                );
                return Err(Impossible::new(key("hung_after_millis"), expected));
            }
        }
        if self.lock_step_patience_millis == 0 {
            return Err(Impossible::new("lock_step_patience_millis", "at least 1 ms"));
        }
        check_telemetry(&self.telemetry).map_err(|impossible| impossible.under("telemetry"))?;
        self.rates.check().map_err(|impossible| impossible.under("rates"))?;
        self.page.check().map_err(|impossible| impossible.under("page"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const GOOD: &str = "name = \"g\"\nrobot = \"r.toml\"\nscenario = \"s.toml\"\n\
                        pace = \"real-time\"\n";

    fn refusal(text: &str) -> Option<String> {
        settings::parse::<Graph>(text, Path::new("g.toml")).err().map(|error| error.to_string())
    }

    #[test]
    fn settings_of_processes_are_optional_in_a_graph() {
        assert_eq!(refusal(GOOD), None);
        assert_eq!(refusal(&format!("{GOOD}[processes.learner]\nenabled = false\n")), None);
    }

    #[test]
    fn an_invalid_delay_of_the_network_is_rejected() {
        let text = refusal(&format!("{GOOD}[network]\ndelay_millis = 18446744073710\n"));
        assert!(text.is_some_and(|text| {
            text.contains("network.delay_millis = 18446744073710: expected at most 10000 ms")
        }));
    }

    #[test]
    fn a_page_without_a_valid_address_is_rejected() {
        assert_eq!(refusal(&format!("{GOOD}[page]\nlisten = \"off\"\n")), None);
        assert!(
            refusal(&format!("{GOOD}[page]\n"))
                .is_some_and(|text| text.contains("page.listen is missing"))
        );
        assert_eq!(
            refusal(&format!("{GOOD}[page]\nlisten = \"8080\"\n")).as_deref(),
            Some(
                "g.toml:6: page.listen = \"8080\": \
                 expected an address and a port such as 127.0.0.1:8080, or off"
            )
        );
    }

    #[test]
    fn a_priority_for_a_process_off_the_control_path_is_rejected() {
        let refused = |role: &str, keys: &str| {
            refusal(&format!("{GOOD}[processes.{role}.scheduling]\n{keys}\n")).unwrap_or_default()
        };
        assert_eq!(
            refused("controller", "processors = [1]\nlock_memory = true\nreal_time_priority = 20"),
            ""
        );
        let text = refused("learner", "real_time_priority = 20");
        assert!(
            text.contains(
                "g.toml:6: processes.learner.scheduling.real_time_priority = 20: expected nothing"
            ),
            "{text}"
        );
        assert!(
            refused("plant", "real_time_priority = 99")
                .contains("g.toml:6: processes.plant.scheduling.real_time_priority = 99")
        );
    }

    #[test]
    fn an_unknown_process_is_rejected() {
        assert_eq!(
            refusal(&format!("{GOOD}[processes.lerner]\n")).as_deref(),
            Some(
                "g.toml:5: processes.lerner = a table: unknown key, \
                 expected one of plant, controller, learner, recorder, gateway, bridge"
            )
        );
    }
}
