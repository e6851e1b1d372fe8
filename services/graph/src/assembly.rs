//! Options + graph + scenario + robot → settings of each process. Everything is read and checked
//! here; nothing is started or created.

use crate::certificates::Certificates;
use crate::exposure::{Exposed, exposed};
#[cfg(feature = "faults")]
use crate::faults::{FaultsFile, LockStepFaultsFile};
use crate::file::Graph;
use crate::first_model;
use crate::hosts::{Host, ONLY_HOST};
use crate::map::{self, MapFile};
use crate::options::Options;
use crate::role::{START_ORDER, program};
use crate::scenario::Scenario;
use bridge::settings::Remote;
use controller::settings::LearnedSettings;
use driver::ProgramSettings;
use gateway::settings::About;
use process::{PRIORITY, Pace, Run};
use protocol::message::{Exposure, Participant};
use robot::{Map, Robot};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible, SettingsError, WriteError};
use std::path::{Component, Path, PathBuf};
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

/// Settings of the recorder: only those of the run.
#[derive(Debug, Serialize)]
struct RecorderSettings {
    run: Run,
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
            return Err(SettingsError::Value {
                file: options.scenario.clone().unwrap_or(own_scenario),
                line: None,
                key: "truth".into(),
                value: None,
                expected: "[truth] or [world]: the graph simulates the plant".into(),
            });
        }
        let robot = robot_of(&robot_file)?;
        let map = scenario.map.as_deref().map(settings::read::<MapFile>).transpose()?;
        graph.pace = options.pace.unwrap_or(graph.pace);
        let folder = options.certificates.clone();
        let folder = folder.or_else(|| {
            graph.certificates.as_ref().map(|table| from(&options.graph, &table.folder))
        });
        let certificates = folder
            .map(|folder| certificates_in(&folder, options, &graph, host.as_deref()))
            .transpose()?;
        let exposed = exposed(&graph, certificates.is_some());
        if certificates.is_none()
            && let Some((key, endpoint)) = over_tls(&graph)
        {
            return Err(SettingsError::Value {
                file: options.graph.clone(),
                line: None,
                key: key.into(),
                value: Some(format!("\"{endpoint}\"")),
                expected: "certificates, as `deploy/certificates` makes them: \
                           [certificates] folder, or --certificates"
                    .into(),
            });
        }
        if let Some(Exposed { key, address }) = exposed.first().filter(|_| !options.insecure) {
            let expected = "an address of this machine alone, such as 127.0.0.1, \
                 certificates (deploy/certificates), or the option --insecure: unauthenticated \
                 peers have access there"
                .to_owned();
            return Err(SettingsError::Value {
                file: options.graph.clone(),
                line: None,
                key: key.clone(),
                value: Some(format!("\"{address}\"")),
                expected,
            });
        }
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
            map: map.map(|MapFile(map)| map),
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
            return Err(SettingsError::Value {
                file: options.graph.clone(),
                line: None,
                key: "--model".into(),
                value: Some(format!("\"{}\"", model.display())),
                expected: "a run with a learner: it publishes the model".into(),
            });
        }
        first_model::read(model, self)?;
        // The settings of the processes must be valid in every working directory.
        let file = std::path::absolute(model).unwrap_or_else(|_| model.to_path_buf());
        self.scenario.learner.resume = Some(file);
        Ok(())
    }

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

    /// Writes all settings of the process of `role` into `file`.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn write_settings(
        &self,
        role: Participant,
        run: Run,
        file: &Path,
    ) -> Result<(), WriteError> {
        match (role, &self.graph.driver) {
            (Participant::Plant, Some(driver)) => {
                settings::write(file, &self.driver(run, driver.settings.clone()))
            }
            (role, _) => self.write_own_settings(role, run, file),
        }
    }

    /// The same, for a program of this project.
    fn write_own_settings(
        &self,
        role: Participant,
        run: Run,
        file: &Path,
    ) -> Result<(), WriteError> {
        match role {
            Participant::Plant => settings::write(file, &self.plant(run)),
            Participant::Controller => settings::write(file, &self.controller(run)),
            Participant::Learner => settings::write(file, &self.learner(run)),
            Participant::Recorder => settings::write(file, &RecorderSettings { run }),
            Participant::Gateway => settings::write(file, &self.gateway(run)),
            Participant::Bridge => settings::write(file, &self.bridge(run)),
        }
    }

    /// Settings of the plant.
    pub fn plant(&self, run: Run) -> plant_sim::Settings {
        let truth = self.scenario.truth.clone();
        // Both were checked together when they were read. If the scenario was changed since, its
        // own faults take precedence.
        #[cfg(feature = "faults")]
        let truth = self.faults.in_world(truth.as_ref()).unwrap_or(truth);
        let obstacles = self.scenario.obstacles.clone();
        #[cfg(feature = "faults")]
        let obstacles = self.faults.among(obstacles.as_ref()).unwrap_or(obstacles);
        plant_sim::Settings {
            run,
            duration_s: self.scenario.duration_s,
            seed: self.scenario.seed,
            link_delay_millis: self.link_delay_millis(),
            armed: self.graph.armed,
            recorded: self.graph.processes.recorder.enabled,
            start: self.scenario.start,
            robot: self.robot,
            truth,
            program: self.scenario.world.clone(),
            map: self.map.clone(),
            obstacles,
            lists: self.scenario.lists.clone(),
        }
    }

    /// Settings of the program that drives the robot, which has `base` for itself.
    fn driver(&self, run: Run, base: toml::Table) -> ProgramSettings<toml::Table> {
        ProgramSettings {
            duration_s: self.scenario.duration_s,
            link_delay_millis: self.link_delay_millis(),
            recorded: self.graph.processes.recorder.enabled,
            armed: self.graph.armed,
            start: self.scenario.start,
            run,
            robot: self.robot,
            map: self.map.clone(),
            lists: self.scenario.lists.clone(),
            base,
        }
    }

    /// Known delay of its links \[ms\].
    pub fn link_delay_millis(&self) -> u64 {
        if self.host.is_some() { self.graph.network.delay_millis } else { 0 }
    }

    /// Settings of the controller.
    pub fn controller(&self, run: Run) -> controller::Settings {
        let learner = &self.scenario.learner;
        controller::Settings {
            sees_obstacles: self.sees_obstacles(run.pace),
            run,
            duration_s: self.scenario.duration_s,
            start: self.scenario.start.pose,
            robot: self.robot,
            reference: self.scenario.reference.clone(),
            goals: self.scenario.goals.clone(),
            map: self.map.clone(),
            mpc: self.scenario.mpc,
            identified: self.scenario.identified.clone(),
            learned: LearnedSettings {
                enabled: self.learns(),
                layout: learner.layout,
                every_ticks: learner.every_ticks,
                delay_ticks: learner.delay_ticks,
                resumed: learner.resume.is_some(),
            },
            #[cfg(feature = "faults")]
            solver_faults: self.faults.of_solver(),
        }
    }

    /// Whether lists of obstacles can arrive: in real time always, from a planner. In lock step
    /// only a simulator sends them for sure.
    fn sees_obstacles(&self, pace: Pace) -> bool {
        let Scenario { obstacles, lists, .. } = &self.scenario;
        let is_real = self.graph.driver.is_some() || self.graph.hosts.values().any(|it| it.driver);
        pace == Pace::RealTime || (!is_real && (obstacles.is_some() || !lists.is_empty()))
    }

    /// Settings of the gateway.
    pub fn gateway(&self, run: Run) -> gateway::settings::Settings {
        let Scenario { description, duration_s, mpc, .. } = &self.scenario;
        let limits = &mpc.state_limits;
        let wheels = &self.robot.wheels;
        let places = wheels.positions_m().iter().zip(wheels.directions_rad());
        let about = About {
            half_extent_m: wheels.half_extent_m(),
            wheels: places
                .zip(wheels.radii_m())
                .map(|(([x, y], direction), radius)| [*x, *y, *direction, *radius])
                .collect(),
            scenario: self.scenario_name.clone(),
            description: description.clone(),
            duration_s: *duration_s,
            heading_rad: limits.heading_rad,
            speed_mps: limits.speed_mps,
            corridor_left_m: limits.corridor_left_m,
            corridor_right_m: limits.corridor_right_m,
            without_learning: self.without_learning.clone(),
            map: self.map.as_ref().map(map::drawn).unwrap_or_default(),
        };
        let Graph { mut telemetry, rates, page, .. } = self.graph.clone();
        telemetry.credentials = self.certificates.as_ref().map(Certificates::credentials);
        let has_plant = self.roles().any(|role| role == Participant::Plant);
        gateway::settings::Settings { run, has_plant, telemetry, rates, page, about }
    }

    /// Settings of the bridge.
    pub fn bridge(&self, mut run: Run) -> bridge::settings::Settings {
        // Its threads give way to those of plant and controller.
        run.scheduling.real_time_priority.get_or_insert(PRIORITY - 1);
        let host = self.host.clone().unwrap_or_else(|| ONLY_HOST.to_owned());
        let of_host = self.graph.hosts.get(&host).map(Host::participants);
        let processes = of_host.unwrap_or_else(|| self.roles().collect());
        let requests = self.graph.requests.get(&host).map(|address| format!("tls/{address}"));
        bridge::settings::Settings {
            run,
            graph: self.graph.name.clone(),
            host,
            processes,
            remotes: self.remotes(),
            requests,
            credentials: self.certificates.as_ref().map(Certificates::credentials),
        }
    }

    /// Settings of the learner.
    pub fn learner(&self, run: Run) -> learner::Settings {
        learner::Settings {
            run,
            robot: self.robot,
            learner: self.scenario.learner.clone(),
            #[cfg(feature = "faults")]
            snapshot_faults: self.faults.of_snapshots(),
        }
    }
}

/// The first endpoint that requires certificates, and its key in the graph file.
fn over_tls(graph: &Graph) -> Option<(&'static str, &String)> {
    let endpoints = &graph.telemetry.listen;
    let over_tls = endpoints.iter().find(|endpoint| endpoint.starts_with("tls/"));
    let watched = over_tls.map(|endpoint| ("telemetry.listen", endpoint));
    watched.or_else(|| Some(("requests", graph.requests.values().next()?)))
}

/// The host that `options` name. Of the graph then only its processes are left, with the addresses
/// of `options`.
fn host_of(options: &Options, graph: &mut Graph) -> Result<Option<String>, SettingsError> {
    let refused = |key: &str, value: &str, expected: String| SettingsError::Value {
        file: options.graph.clone(),
        line: None,
        key: key.to_owned(),
        value: Some(format!("\"{value}\"")),
        expected,
    };
    let hosts = || graph.hosts.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
    let Some(name) = &options.host else {
        return match options.addresses.first() {
            None => Ok(None),
            Some((host, _)) => Err(refused("--address", host, "--host NAME beside it".to_owned())),
        };
    };
    if graph.hosts.get(name).is_none_or(|host| host.driver) {
        let expected = if graph.hosts.is_empty() {
            "no --host: the graph file has no hosts".to_owned()
        } else {
            format!("one of the hosts of the graph file that is no driver: {}", hosts())
        };
        return Err(refused("--host", name, expected));
    }
    for (other, address) in &options.addresses {
        let Some(connection) =
            graph.connections.iter_mut().find(|one| one.other(name) == Some(other.as_str()))
        else {
            let expected = format!("a host with a connection to {name}");
            return Err(refused("--address", other, expected));
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
    Certificates::check(&folder, graph, host).map_err(|error| SettingsError::Value {
        file: options.graph.clone(),
        line: None,
        key: "certificates.folder".into(),
        value: Some(format!("\"{}\"", folder.display())),
        expected: format!("certificates that this launch can use: {error}"),
    })
}

/// Reads and checks a robot file.
///
/// # Errors
/// [`SettingsError`] reports the first error and its place.
pub fn robot_of(file: &Path) -> Result<Robot, SettingsError> {
    settings::read(file).map(|RobotFile(robot)| robot)
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
        Err(Impossible { key, expected }) => {
            Err(SettingsError::Value { file: file.clone(), line: None, key, value: None, expected })
        }
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
fn from(file: &Path, path: &Path) -> PathBuf {
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
fn scenario_of(asked: Option<&Path>, own: &Path) -> Result<(Scenario, String), SettingsError> {
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

/// Those of `programs` that are not in `folder`.
pub fn missing_programs<'a>(
    programs: impl Iterator<Item = &'a Path>,
    folder: &Path,
) -> Vec<String> {
    let missing = programs.filter(|program| !folder.join(program).is_file());
    missing.map(|program| program.display().to_string()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_robot_of_the_examples_is_the_one_of_the_repository() -> Result<(), SettingsError> {
        let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/graphs/local.toml");
        assert_eq!(Assembly::read(&Options::of_graph(&graph))?.robot, Robot::example());
        Ok(())
    }

    #[test]
    fn the_example_of_faults_can_be_used() -> Result<(), SettingsError> {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/faults/example.toml");
        let faults = faults_of(&file, Pace::RealTime)?;
        assert_eq!((faults.fault.len(), faults.process.len(), faults.solver.len()), (3, 2, 1));
        assert_eq!((faults.snapshot.len(), faults.plant.len()), (1, 2));
        Ok(())
    }

    #[test]
    fn a_scenario_is_selected_by_file_or_by_name_with_variants() -> Result<(), SettingsError> {
        let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenarios/paper.toml");
        let name = |asked: Option<&Path>| scenario_of(asked, &own).map(|(_, name)| name);
        assert_eq!(name(None)?, "paper");
        assert_eq!(name(Some(Path::new("circle")))?, "circle");
        assert_eq!(name(Some(&own.with_file_name("square.toml")))?, "square");
        assert_eq!(name(Some(Path::new("figure-eight+payload")))?, "figure-eight+payload");
        let refused = [
            name(Some(Path::new("my/circle"))),
            name(Some(Path::new("circle.toml"))),
            name(Some(Path::new("ellipse"))),
        ];
        assert!(refused.iter().all(Result::is_err), "{refused:?}");
        Ok(())
    }

    #[test]
    fn a_path_in_a_graph_file_is_shortened() {
        let short = |file, path| from(Path::new(file), Path::new(path));
        assert_eq!(
            short("deploy/graphs/g.toml", "../robots/r.toml"),
            Path::new("deploy/robots/r.toml")
        );
        assert_eq!(short("g.toml", "../r.toml"), Path::new("../r.toml"));
        assert_eq!(short("g.toml", "/etc/r.toml"), Path::new("/etc/r.toml"));
    }

    #[test]
    fn the_driver_is_a_program_beside_ours_or_a_path_from_the_graph_file()
    -> Result<(), Box<dyn std::error::Error>> {
        let deploy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy");
        let text = std::fs::read_to_string(deploy.join("graphs/serial-base.toml"))?;
        let text = text.replace("\"../", &format!("\"{}/", deploy.display()));
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("graph.toml");
        for (program, expected) in [
            ("serial-base", PathBuf::from("serial-base")),
            ("programs/mine", folder.path().join("programs/mine")),
            ("/usr/bin/mine", PathBuf::from("/usr/bin/mine")),
        ] {
            let text = text.replace("program = \"serial-base\"", &format!("program = {program:?}"));
            std::fs::write(&file, text)?;
            let assembly = Assembly::read(&Options::of_graph(&file))?;
            assert_eq!(assembly.program(Participant::Plant), expected);
            assert_eq!(assembly.program(Participant::Recorder), Path::new("recorder"));
        }
        Ok(())
    }

    #[test]
    fn a_missing_binary_is_named_in_the_error() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        std::fs::write(folder.path().join("recorder"), "")?;
        let programs = ["recorder", "plant-sim"].map(Path::new);
        let missing = missing_programs(programs.into_iter(), folder.path());
        assert_eq!(missing, ["plant-sim"]);
        Ok(())
    }
}
