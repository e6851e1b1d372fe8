//! Options + graph + scenario + robot → settings of each process. Everything is read and checked
//! here; nothing is started or created.

mod processes;
mod read;
#[cfg(test)]
mod tests;

#[cfg(feature = "faults")]
pub use read::faults_of;
pub use read::{map_of, robot_of};

use crate::certificates::Certificates;
use crate::exposure::Exposed;
#[cfg(feature = "faults")]
use crate::faults::FaultsFile;
use crate::file::Graph;
use crate::role::{START_ORDER, program};
use crate::scenario::Scenario;
use bridge::settings::Remote;
use process::Pace;
use protocol::message::{Exposure, Participant};
use robot::{Map, Robot};
use std::path::{Path, PathBuf};
use transport::Links;

/// A graph that can be launched.
#[derive(Debug, Clone)]
pub struct Assembly {
    /// The graph, with the changes of the command line.
    pub graph: Graph,
    /// The host of the graph file that this machine is; none if the graph has no hosts.
    pub host: Option<String>,
    /// The scenario, with the changes of the command line.
    pub scenario: Scenario,
    /// Name of the scenario: that of its file, without the extension.
    pub scenario_name: String,
    /// The robot as the controller believes it to be.
    pub robot: Robot,
    /// Known obstacles, zones and border, if there is a map.
    pub map: Option<Map>,
    /// Log filter.
    pub log: String,
    /// The certificates that the launch and its processes present, if there are any.
    pub certificates: Option<Certificates>,
    /// Whether another host runs the learner.
    pub learns_elsewhere: bool,
    /// Its addresses that unauthenticated peers on the network can reach.
    pub exposed: Vec<Exposed>,
    /// Faults to inject.
    #[cfg(feature = "faults")]
    pub faults: FaultsFile,
    /// File with the same run without learning, once there is one.
    pub without_learning: Option<PathBuf>,
}

impl Assembly {
    /// Its processes, in the order in which they start.
    pub fn roles(&self) -> impl Iterator<Item = Participant> + use<'_> {
        START_ORDER.into_iter().filter(|&role| self.graph.processes.of(role).enabled)
    }

    /// The program of `role`: a name in the directory of the binaries, or a path.
    pub fn program(&self, role: Participant) -> &Path {
        let driver = self.graph.driver.as_ref().filter(|_| role == Participant::Plant);
        driver.map_or(Path::new(program(role)), |driver| &driver.program)
    }

    /// Access of unauthenticated peers on the network.
    pub fn exposure(&self) -> Exposure {
        self.exposed.iter().map(Exposed::lets).max().unwrap_or(Exposure::Closed)
    }

    /// Whether a learner is enabled, here or on another host.
    pub fn learns(&self) -> bool {
        self.graph.processes.learner.enabled || self.learns_elsewhere
    }

    /// The other hosts with which this one exchanges messages.
    pub fn remotes(&self) -> Vec<Remote> {
        self.host.as_ref().map_or_else(Vec::new, |host| self.graph.deployment().remotes(host))
    }

    /// The process with which the run ends: the plant, or, on a host without a connection to the
    /// plant's, the controller.
    pub fn finishes_with(&self) -> Participant {
        let knows_plant =
            self.remotes().iter().any(|remote| remote.processes.contains(&Participant::Plant));
        if self.host.is_none() || self.graph.processes.plant.enabled || knows_plant {
            Participant::Plant
        } else {
            Participant::Controller
        }
    }

    /// Its links, without faults, for the graph with the id `id`. Their files are in `root`.
    pub fn links(&self, id: &str, root: &Path) -> Links {
        let lock_step = self.graph.pace == Pace::LockStep;
        Links::on_this_machine(id, root, lock_step, self.graph.lock_step_patience_millis)
    }
}

/// Those of `programs` that are not in `folder`.
pub fn missing_programs<'a>(
    programs: impl Iterator<Item = &'a Path>,
    folder: &Path,
) -> Vec<String> {
    let missing = programs.filter(|program| !folder.join(program).is_file());
    missing.map(|program| program.display().to_string()).collect()
}
