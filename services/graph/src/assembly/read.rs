//! Files of a graph → an assembly.

use super::Assembly;
use crate::certificates::Certificates;
use crate::exposure::{Exposed, exposed};
#[cfg(feature = "faults")]
use crate::faults::{FaultsFile, LockStepFaultsFile};
use crate::file::Graph;
use crate::first_model;
use crate::map::MapFile;
use crate::options::Options;
use crate::scenario::Scenario;
#[cfg(feature = "faults")]
use process::Pace;
use robot::{Map, Robot};
use serde::Deserialize;
use settings::{Check, Impossible, SettingsError};
use std::fmt::Display;
use std::path::{Component, Path, PathBuf};

/// A robot file.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
struct RobotFile(Robot);

impl Check for RobotFile {
    fn check(&self) -> Result<(), Impossible> {
        self.0.check().map_err(|impossible| Impossible::new(impossible.key, impossible.expected))
    }

    fn replaced() -> &'static [(&'static str, &'static str)] {
        &[("geometry", "[wheels.mecanum] with radius_m, wheelbase_m and track_m")]
    }
}

impl Assembly {
    /// Reads and checks the files that `options` name.
    ///
    /// # Errors
    /// [`SettingsError`] reports the first error and its place.
    pub fn read(options: &Options) -> Result<Self, SettingsError> {
        let mut graph: Graph = settings::read(&options.graph)?;
        let own_scenario = from(&options.graph, &graph.scenario);
        let robot_file =
            options.robot.clone().unwrap_or_else(|| from(&options.graph, &graph.robot));
        let (mut scenario, scenario_name) =
            scenario_of(options.scenario.as_deref(), &own_scenario)?;
        graph.processes.learner.enabled =
            options.learner.unwrap_or(graph.processes.learner.enabled);
        let has_learner = graph.processes.learner.enabled;
        let host = host_of(options, &mut graph)?;
        let learns_elsewhere = has_learner && !graph.processes.learner.enabled && host.is_some();
        if let Some(driver) = &mut graph.driver
            && driver.program.components().count() > 1
        {
            let path = from(&options.graph, &driver.program);
            driver.program = std::path::absolute(&path).unwrap_or(path);
        }
        graph.processes.bridge.enabled |= host.is_none() && !graph.requests.is_empty();
        let is_simulated = graph.processes.plant.enabled && graph.driver.is_none();
        if is_simulated && scenario.truth.is_none() && scenario.world.is_none() {
            let file = options.scenario.as_ref().unwrap_or(&own_scenario);
            let expected = "[truth] or [world]: the graph simulates the plant";
            return Err(refused(file, "truth", None, expected));
        }
        let robot = robot_of(&robot_file)?;
        let map = scenario.map.as_deref().map(map_of).transpose()?;
        graph.pace = options.pace.unwrap_or(graph.pace);
        let folder = options.certificates.clone();
        let folder = folder.or_else(|| {
            graph.certificates.as_ref().map(|table| from(&options.graph, &table.folder))
        });
        let certificates = folder
            .map(|folder| certificates_in(&folder, options, &graph, host.as_deref()))
            .transpose()?;
        let exposed = exposed(&graph, certificates.is_some());
        check_endpoints(options, &graph, certificates.is_some(), &exposed)?;
        scenario.duration_s = options.duration.unwrap_or(scenario.duration_s);
        scenario.seed = options.seed.unwrap_or(scenario.seed);
        #[cfg(feature = "faults")]
        let faults = faults_for(options, graph.pace, &scenario)?;
        let mut assembly = Self {
            certificates,
            exposed,
            graph,
            host,
            learns_elsewhere,
            scenario,
            scenario_name,
            robot,
            map,
            log: options.log.clone(),
            #[cfg(feature = "faults")]
            faults,
            without_learning: None,
        };
        if let Some(model) = &options.model {
            assembly.begin_with(model, options)?;
        }
        Ok(assembly)
    }

    /// Begins with the snapshot `model`.
    fn begin_with(&mut self, model: &Path, options: &Options) -> Result<(), SettingsError> {
        if !self.learns() {
            let expected = "a run with a learner: it publishes the model";
            return Err(refused(&options.graph, "--model", Some(&model.display()), expected));
        }
        first_model::read(model, self)?;
        // The settings of the processes must be valid in every working directory.
        let file = std::path::absolute(model).unwrap_or_else(|_| model.to_path_buf());
        self.scenario.learner.resume = Some(file);
        Ok(())
    }
}

/// The first endpoint that requires certificates, and its key in the graph file.
fn over_tls(graph: &Graph) -> Option<(&'static str, &String)> {
    let endpoints = &graph.telemetry.listen;
    let over_tls = endpoints.iter().find(|endpoint| endpoint.starts_with("tls/"));
    let watched = over_tls.map(|endpoint| ("telemetry.listen", endpoint));
    watched.or_else(|| Some(("requests", graph.requests.values().next()?)))
}

/// Checks that peers on the network are authenticated, or permitted by `options`.
fn check_endpoints(
    options: &Options,
    graph: &Graph,
    has_certificates: bool,
    exposed: &[Exposed],
) -> Result<(), SettingsError> {
    if let Some((key, endpoint)) = over_tls(graph).filter(|_| !has_certificates) {
        let expected = "certificates, as `deploy/certificates` makes them: [certificates] folder, \
                        or --certificates";
        return Err(refused(&options.graph, key, Some(endpoint), expected));
    }
    match exposed.first().filter(|_| !options.insecure) {
        None => Ok(()),
        Some(Exposed { key, address }) => {
            let expected = "an address of this machine alone, such as 127.0.0.1, certificates \
                            (deploy/certificates), or the option --insecure: unauthenticated peers \
                            have access there";
            Err(refused(&options.graph, key, Some(address), expected))
        }
    }
}

/// The error of a value in `file` that cannot be used.
fn refused(
    file: &Path,
    key: &str,
    value: Option<&dyn Display>,
    expected: impl Into<String>,
) -> SettingsError {
    SettingsError::Value {
        file: file.to_path_buf(),
        line: None,
        key: key.to_owned(),
        value: value.map(|value| format!("\"{value}\"")),
        expected: expected.into(),
    }
}

/// The host that `options` name. Of the graph then only its processes are left, with the addresses
/// of `options`.
fn host_of(options: &Options, graph: &mut Graph) -> Result<Option<String>, SettingsError> {
    let hosts = || graph.hosts.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
    let Some(name) = &options.host else {
        return match options.addresses.first() {
            None => Ok(None),
            Some((host, _)) => {
                Err(refused(&options.graph, "--address", Some(host), "--host NAME beside it"))
            }
        };
    };
    if graph.hosts.get(name).is_none_or(|host| host.driver) {
        let expected = if graph.hosts.is_empty() {
            "no --host: the graph file has no hosts".to_owned()
        } else {
            format!("one of the hosts of the graph file that is no driver: {}", hosts())
        };
        return Err(refused(&options.graph, "--host", Some(name), expected));
    }
    for (other, address) in &options.addresses {
        let Some(connection) =
            graph.connections.iter_mut().find(|one| one.other(name) == Some(other.as_str()))
        else {
            let expected = format!("a host with a connection to {name}");
            return Err(refused(&options.graph, "--address", Some(other), expected));
        };
        if connection.router.is_some() {
            connection.router = Some(address.clone());
        } else {
            (connection.address, connection.listen) = (Some(address.clone()), None);
        }
    }
    // What other hosts use of the other connections does not matter here.
    graph.connections.retain(|connection| connection.other(name).is_some());
    graph.keep_host(name);
    Ok(Some(name.clone()))
}

/// The certificates in `folder`, if they are valid for a launch of `graph`.
fn certificates_in(
    folder: &Path,
    options: &Options,
    graph: &Graph,
    host: Option<&str>,
) -> Result<Certificates, SettingsError> {
    // The settings of the processes must be valid in every working directory.
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
    Certificates::check(&folder, graph, host).map_err(|error| {
        let expected = format!("certificates that this launch can use: {error}");
        refused(&options.graph, "certificates.folder", Some(&folder.display()), expected)
    })
}

/// Reads and checks a robot file.
///
/// # Errors
/// [`SettingsError`] reports the first error and its place.
pub fn robot_of(file: &Path) -> Result<Robot, SettingsError> {
    settings::read(file).map(|RobotFile(robot)| robot)
}

/// Reads and checks a map file.
///
/// # Errors
/// [`SettingsError`] reports the first error and its place.
pub fn map_of(file: &Path) -> Result<Map, SettingsError> {
    settings::read(file).map(|MapFile(map)| map)
}

/// The faults that the options name, for a run of this pace in this world.
#[cfg(feature = "faults")]
fn faults_for(
    options: &Options,
    pace: Pace,
    scenario: &Scenario,
) -> Result<FaultsFile, SettingsError> {
    let Some(file) = &options.faults else { return Ok(FaultsFile::default()) };
    let faults = faults_of(file, pace)?;
    let possible = faults
        .in_world(scenario.truth.as_ref())
        .and_then(|_| faults.among(scenario.obstacles.as_ref()));
    match possible {
        Ok(_) => Ok(faults),
        Err(Impossible { key, expected }) => Err(refused(file, &key, None, expected)),
    }
}

/// Reads and checks a file of faults for a run of this pace.
///
/// # Errors
/// [`SettingsError`] reports the first error and its place.
#[cfg(feature = "faults")]
pub fn faults_of(file: &Path, pace: Pace) -> Result<FaultsFile, SettingsError> {
    match pace {
        Pace::RealTime => settings::read(file),
        Pace::LockStep => settings::read(file).map(|LockStepFaultsFile(faults)| faults),
    }
}

/// A path relative to `file`, in its shortest form.
pub(super) fn from(file: &Path, path: &Path) -> PathBuf {
    let folder = file.parent().unwrap_or(Path::new(""));
    let mut short = folder.to_path_buf();
    for part in path.components() {
        match (part, short.components().next_back()) {
            (Component::CurDir, _) => {}
            (Component::ParentDir, Some(Component::Normal(_))) => drop(short.pop()),
            _ => short.push(part),
        }
    }
    let whole = folder.join(path);
    // Behind a symbolic link to a directory the short path may lead to another place.
    if whole.exists() && !short.exists() { whole } else { short }
}

/// The requested scenario and its name. The request is a file, or the name of a scenario beside the
/// graph's `own`, with variants as in `figure-eight+payload`.
pub(super) fn scenario_of(
    asked: Option<&Path>,
    own: &Path,
) -> Result<(Scenario, String), SettingsError> {
    let Some(asked) = asked else { return Ok((Scenario::read(own)?, name_of(own))) };
    if asked.extension().is_some() || asked.components().count() > 1 || asked.is_file() {
        return Ok((Scenario::read(asked)?, name_of(asked)));
    }
    let name = asked.to_string_lossy().into_owned();
    Ok((Scenario::named(own.parent().unwrap_or(Path::new("")), &name, None, &[])?, name))
}

/// Name of its file without the extension.
fn name_of(file: &Path) -> String {
    file.file_stem().map_or_else(|| "scenario".into(), |stem| stem.to_string_lossy().into_owned())
}
