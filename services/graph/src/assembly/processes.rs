//! An assembly → the settings of each process.

use super::Assembly;
use crate::certificates::Certificates;
use crate::file::Graph;
use crate::hosts::{Host, ONLY_HOST};
use crate::map;
use crate::scenario::Scenario;
use controller::settings::LearnedSettings;
use driver::ProgramSettings;
use gateway::settings::About;
use process::{PRIORITY, Pace, Run};
use protocol::message::Participant;
use serde::Serialize;
use settings::WriteError;
use std::path::Path;

/// Settings of the recorder: only those of the run.
#[derive(Debug, Serialize)]
struct RecorderSettings {
    run: Run,
}

impl Assembly {
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
