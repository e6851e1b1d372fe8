//! What all exercises of a drill share: robot and scenario, and how well that robot tracks its
//! reference without faults.

use super::catalogue::{Carrier, Launch};
use super::oracle::Limits;
use super::record::Record;
use super::session::{Home, Trouble};
use super::tracking::{Course, Twin, largest_error};
use experiment::in_process;
use graph::assembly::Assembly;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Length of a twin's run: two laps after the start \[s\].
const TWIN_S: f64 = 18.0;
/// Fault of an optimiser without a plan, once the robot drives.
const WITHOUT_OPTIMISER: &str =
    "[[solver]]\nkind = \"infeasible\"\nfrom_tick = 1\nuntil_tick = 1000000\n";

/// Robot and scenario of a drill.
#[derive(Debug)]
pub(super) struct Ground {
    deploy: PathBuf,
    course: OnceLock<Result<Course, String>>,
}

impl Ground {
    /// Robot and scenario of the folder `deploy`.
    pub(super) fn new(deploy: &Path) -> Self {
        Self { deploy: deploy.to_path_buf(), course: OnceLock::new() }
    }

    /// The folder.
    pub(super) fn deploy(&self) -> &Path {
        &self.deploy
    }

    /// The robot's reference, and how closely the robot tracks it without faults. The first call
    /// runs the twins, which takes seconds.
    ///
    /// # Errors
    /// If a twin does not finish.
    pub(super) fn course(&self) -> Result<&Course, Trouble> {
        let course =
            self.course.get_or_init(|| self.run_twins().map_err(|error| error.to_string()));
        course.as_ref().map_err(|error| format!("the fault-free twin: {error}").into())
    }

    fn run_twins(&self) -> Result<Course, Trouble> {
        let (assembly, fresh) = self.run_twin("")?;
        let (_, without_optimiser) = self.run_twin(WITHOUT_OPTIMISER)?;
        let (limits, course) = (Limits::of(&assembly), Course::of(&assembly, Twin::default()));
        let twin = Twin {
            fresh_m: largest_error(&fresh, &limits, &course)?,
            without_optimiser_m: largest_error(&without_optimiser, &limits, &course)?,
        };
        Ok(course.with(twin))
    }

    fn run_twin(&self, faults: &str) -> Result<(Assembly, Record), Trouble> {
        let launch = Launch { lock_step: true, faults: faults.to_owned(), ..Launch::default() };
        let home = Home::new(self, Carrier::SharedMemory, &launch, 1)?;
        let mut assembly = home.assembly()?;
        assembly.scenario.duration_s = TWIN_S;
        let folder = home.folder().join("twin");
        fs::create_dir(&folder)?;
        in_process::run(&assembly, &folder)?;
        Ok((assembly, Record::read_without_rows(&folder)?))
    }
}
