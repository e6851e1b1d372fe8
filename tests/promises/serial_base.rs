//! Promise: a base at a serial port is driven through a bad cable, its motors stop by themselves
//! when the driver dies or hangs, and a lost port is named.
//!
//! The judge is the table of the simulated firmware: what its motors did in every step.

use promises::firmware::{self, BAD_CABLE, DRIVES, Firmware, STANDS, Step, port};
use promises::{
    Ended, Launched, Outcome, Record, binaries, graph_with, launch_command, signal, wait_until,
};
use rustix::process::Signal;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::Duration;
use tempfile::TempDir;

/// The steps so far, of all firmwares that were started in `home`.
fn steps(home: &Path) -> Result<Vec<Step>, Box<dyn Error>> {
    Ok(firmware::steps(home)?)
}

/// Starts the firmware in `home`.
fn start(home: &Path, noise: &[&str]) -> Result<Firmware, Box<dyn Error>> {
    Ok(Firmware::start(binaries()?, home, noise)?)
}

/// Number of steps with motion, so that no judgement is about a robot that stood.
///
/// # Panics
/// If the motors had a target after the time of the watchdog, or the robot moved much later, or too
/// fast.
fn acquit(steps: &[Step]) -> usize {
    assert_eq!(firmware::judge(steps), [""; 0]);
    steps.iter().filter(|step| step.speed() > DRIVES).count()
}

/// A robot at a port, and the launch that drives it.
struct Rig {
    firmware: Option<Firmware>,
    launched: Launched,
}

impl Rig {
    fn new(noise: &[&str], tables: &str, options: &[&str]) -> Result<Self, Box<dyn Error>> {
        let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        let firmware = Some(start(home.path(), noise)?);
        let port = quoted(&port(home.path()));
        Ok(Self { firmware, launched: launch(home, &port, tables, options)? })
    }

    fn home(&self) -> &Path {
        self.launched.home()
    }

    /// Waits until the robot drives, at a time after now.
    fn wait_until_it_drives(&self) -> Outcome {
        let known = steps(self.home())?.len();
        self.launched.wait_until("a robot that drives", || {
            let steps = steps(self.home()).unwrap_or_default();
            steps.iter().skip(known).any(|step| step.speed() > DRIVES)
        })
    }

    /// Waits for the end of the launch.
    fn end(self) -> Result<(Ended, TempDir), Box<dyn Error>> {
        let ended = self.launched.end()?;
        drop(self.firmware);
        Ok(ended)
    }
}

/// The setting of a port.
fn quoted(port: &Path) -> String {
    format!("port = \"{}\"", port.display())
}

/// Launches `serial-base.toml` with these `settings` of its driver, and tables of its processes.
fn launch(
    home: TempDir,
    settings: &str,
    tables: &str,
    options: &[&str],
) -> Result<Launched, Box<dyn Error>> {
    let graph = graph_with("serial-base", tables, home.path())?;
    let text = fs::read_to_string(&graph)?;
    let shipped = "port = \"/dev/ttyUSB0\"\nbaud = 115200";
    assert!(text.contains(shipped), "{text}");
    fs::write(&graph, text.replace(shipped, settings))?;
    let command = launch_command(&graph, &home.path().join("run"), options)?;
    Launched::by(command, home)
}

/// Every recorded velocity is one that the firmware has had.
fn every_measurement_is_one_that_was_sent(home: &Path) -> Outcome {
    let record = Record::read(&home.join("run"))?;
    assert_eq!(firmware::unsent(&record, &steps(home)?), [""; 0]);
    let count = record.of("state").count();
    assert!(count > 10, "{count} states");
    Ok(())
}

#[test]
fn a_base_at_a_serial_port_drives_its_scenario() -> Outcome {
    let (ended, home) = Rig::new(&[], "", &["--duration", "8"])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    assert!(acquit(&steps(home.path())?) > 100);
    every_measurement_is_one_that_was_sent(home.path())?;
    let record = Record::read(&home.path().join("run"))?;
    let last = record.of("state").next_back().ok_or("no state")?;
    assert_eq!(last.word("fallback_level"), "fresh plan");
    assert_eq!(record.summary["figures_of"], "measured");
    let rmse = record.summary["position_rmse_m"].as_f64();
    assert!(rmse.is_some_and(|rmse| rmse < 0.2), "{}", record.summary);
    Ok(())
}

#[test]
fn the_motors_stop_by_themselves_when_the_driver_is_killed() -> Outcome {
    let rig = Rig::new(&[], "[processes.plant]\nrestarts_per_minute = 0\n", &["--duration", "60"])?;
    rig.wait_until_it_drives()?;
    signal(rig.launched.process("serial-base", None)?, Signal::KILL)?;
    let has_stopped = |steps: Vec<Step>| {
        steps.last().is_some_and(|step| step.stopped_by_watchdog && step.speed() < STANDS)
    };
    wait_until("motors at rest", || steps(rig.home()).is_ok_and(has_stopped))?;
    let steps = steps(rig.home())?;
    assert!(acquit(&steps) > 10);
    let last = steps.last().ok_or("no step")?.line_nanos;
    let overdue: Vec<&Step> = steps.iter().filter(|step| step.nanos > last).collect();
    assert!(overdue.iter().any(|step| step.speed() > DRIVES), "it was killed in motion");
    let (ended, _home) = rig.end()?;
    assert!(!ended.status.success(), "{}", ended.text);
    Ok(())
}

#[test]
fn the_motors_stop_by_themselves_when_the_driver_hangs_and_drive_again_later() -> Outcome {
    let rig = Rig::new(&[], "", &["--duration", "8"])?;
    rig.wait_until_it_drives()?;
    let pid = rig.launched.process("serial-base", None)?;
    signal(pid, Signal::STOP)?;
    rig.launched.process("serial-base", Some(pid))?;
    rig.wait_until_it_drives()?;
    let (ended, home) = rig.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let steps = steps(home.path())?;
    acquit(&steps);
    assert!(steps.iter().any(|step| step.stopped_by_watchdog && step.line_nanos > 0));
    Ok(())
}

#[test]
fn the_gate_brakes_after_a_time_in_which_the_driver_was_suspended() -> Outcome {
    // The launcher does not take the suspension for a hang.
    let patient = "[processes.plant]\nhung_after_millis = 60000\n";
    let rig = Rig::new(&[], patient, &["--duration", "8"])?;
    rig.wait_until_it_drives()?;
    let pid = rig.launched.process("serial-base", None)?;
    signal(pid, Signal::STOP)?;
    // Five periods: more than the three for which a command may act.
    thread::sleep(Duration::from_millis(500));
    signal(pid, Signal::CONT)?;
    rig.wait_until_it_drives()?;
    assert_eq!(rig.launched.process("serial-base", None)?, pid);
    let (ended, home) = rig.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    acquit(&steps(home.path())?);
    let record = Record::read(&home.path().join("run"))?;
    let levels: Vec<&str> = record.of("state").map(|state| state.word("fallback_level")).collect();
    assert!(levels.contains(&"brake"), "no brake after the suspension: {levels:?}");
    Ok(())
}

#[test]
fn a_firmware_that_dies_and_returns_is_driven_again() -> Outcome {
    let mut rig = Rig::new(&[], "", &["--duration", "8"])?;
    rig.wait_until_it_drives()?;
    let pid = rig.launched.process("serial-base", None)?;
    rig.firmware = None;
    rig.launched.process("serial-base", Some(pid))?;
    rig.firmware = Some(start(rig.home(), &[])?);
    rig.wait_until_it_drives()?;
    let (ended, home) = rig.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    acquit(&steps(home.path())?);
    Ok(())
}

#[test]
fn a_firmware_that_dies_for_good_ends_the_run_with_the_name_of_its_port() -> Outcome {
    let tables = "[processes.plant]\nrestarts_per_minute = 2\n";
    let mut rig = Rig::new(&[], tables, &["--duration", "60"])?;
    rig.wait_until_it_drives()?;
    let port = port(rig.home()).display().to_string();
    rig.firmware = None;
    let (ended, _home) = rig.end()?;
    assert!(!ended.status.success() && ended.text.contains(&port), "{}", ended.text);
    Ok(())
}

/// Exercises with seeds: a bad cable, and processes that die and hang while the robot drives.
#[test]
fn a_bad_cable_and_dying_processes_never_move_the_robot_without_a_command() -> Outcome {
    for (seed, deaths) in [
        ("1", [("serial-base", Signal::KILL), ("controller", Signal::KILL)]),
        ("2", [("controller", Signal::STOP), ("serial-base", Signal::STOP)]),
        ("3", [("serial-base", Signal::KILL), ("serial-base", Signal::KILL)]),
    ] {
        let rig =
            Rig::new(&[&BAD_CABLE[..], &["--seed", seed]].concat(), "", &["--duration", "8"])?;
        let pause = Duration::from_millis(37 * seed.parse::<u64>()?);
        for (program, death) in deaths {
            rig.wait_until_it_drives()?;
            thread::sleep(pause);
            let pid = rig.launched.process(program, None)?;
            signal(pid, death)?;
            rig.launched.process(program, Some(pid))?;
        }
        rig.wait_until_it_drives()?;
        let (ended, home) = rig.end()?;
        assert!(ended.status.success(), "seed {seed}: {}", ended.text);
        let steps = steps(home.path())?;
        assert!(acquit(&steps) > 100, "seed {seed}");
        assert!(steps.iter().any(|step| step.rejected > 5), "seed {seed}: no velocity line fell");
        every_measurement_is_one_that_was_sent(home.path())?;
        let log = fs::read_to_string(home.path().join("run/plant.log"))?;
        assert!(log.lines().any(|line| line.contains(" fault=")), "seed {seed}: {log}");
    }
    Ok(())
}

#[test]
fn a_port_that_is_none_is_named_before_anything_moves() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (file, missing) = (folder.path().join("file"), folder.path().join("missing"));
    fs::write(&file, "")?;
    for port in [file.as_path(), missing.as_path(), Path::new("/dev/null")] {
        refused(&quoted(port), &[&port.display().to_string()])?;
    }
    refused("port = \"ttyUSB0\"", &["plant.toml:", "base.port", "ttyUSB0"])?;
    refused("port = \"/dev/null\"\nbaud = 300", &["plant.toml:", "base.baud", "300"])?;
    refused("port = \"/dev/null\"\nparity = 1", &["plant.toml:", "base.parity", "baud"])?;
    refused("baud = 115200", &["plant.toml:", "base.port"])
}

/// A launch with these `settings` of the driver fails, and its error contains all of `parts`.
fn refused(settings: &str, parts: &[&str]) -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let (ended, _home) = launch(home, settings, "", &["--duration", "1"])?.end()?;
    assert!(!ended.status.success(), "{}", ended.text);
    for part in parts {
        assert!(ended.text.contains(part), "{part:?} is not in {}", ended.text);
    }
    Ok(())
}
