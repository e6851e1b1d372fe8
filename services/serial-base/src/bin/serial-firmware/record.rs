//! What the motors did in each step → a table (CSV), complete up to the last step.

use crate::motors::Motors;
use anyhow::Context;
use std::fs::File;
use std::io::Write;
use std::path::Path;

/// The table. Lengths are in m, angles in rad, times in s on the monotonic clock in ns.
const COLUMNS: &str = "nanos,target_forward,target_left,target_yaw,forward,left,yaw,\
                       line,line_nanos,valid_millis,rejected,watchdog";

/// The open table.
#[derive(Debug)]
pub(crate) struct Record(File);

impl Record {
    /// Continues the table in `path`, or begins it.
    pub(crate) fn create(path: &Path) -> anyhow::Result<Self> {
        let file = File::options().append(true).create(true).open(path);
        let mut file = file.with_context(|| format!("{} cannot be written", path.display()))?;
        if file.metadata()?.len() == 0 {
            writeln!(file, "{COLUMNS}")?;
        }
        Ok(Self(file))
    }

    /// Writes one step. Only whole rows are written, so that a killed process leaves no half one.
    pub(crate) fn write(&mut self, now: u64, motors: &Motors, rejected: u32) -> anyhow::Result<()> {
        let ([tx, ty, tw], [vx, vy, vw]) = (motors.target(), motors.velocity_micro());
        let [vx, vy, vw] = [vx, vy, vw].map(|value| f64::from(value) * 1e-6);
        let (line, at) = motors.last().unwrap_or_default();
        let (sequence, valid) = (line.sequence, line.valid_millis);
        let watchdog = u8::from(motors.stopped_by_watchdog());
        let row = format!(
            "{now},{tx},{ty},{tw},{vx},{vy},{vw},{sequence},{at},{valid},{rejected},{watchdog}\n"
        );
        self.0.write_all(row.as_bytes())?;
        Ok(())
    }
}
