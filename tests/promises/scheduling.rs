//! Promise: processes run with the processors, the priority and the memory of their graph file.
//! What the system does not permit is reported before the robot moves.

use promises::{Launched, Outcome, graph_with, launch_command};
use std::fs;
use std::process::Command;

fn launched_with(tables: &str, before: &[&str]) -> Result<Launched, Box<dyn std::error::Error>> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let launch = launch_command(
        &graph_with("local", tables, home.path())?,
        &home.path().join("run"),
        &["--duration", "600"],
    )?;
    let command = match before {
        [] => launch,
        [program, arguments @ ..] => {
            let mut command = Command::new(program);
            command.args(arguments).arg(launch.get_program()).args(launch.get_args());
            command
        }
    };
    Launched::by(command, home)
}

/// The system's value of `key` for a process.
fn status(pid: u32, key: &str) -> Result<String, Box<dyn std::error::Error>> {
    let text = fs::read_to_string(format!("/proc/{pid}/status"))?;
    let line = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'));
    Ok(line.ok_or("no such key")?.trim().to_owned())
}

/// Real-time priority of the main thread; 0 if it has none.
fn priority(pid: u32) -> Result<u64, Box<dyn std::error::Error>> {
    let text = fs::read_to_string(format!("/proc/{pid}/stat"))?;
    // Field 40; the name, field 2, may contain anything.
    let fields = text.rsplit_once(") ").ok_or("no name")?.1;
    Ok(fields.split_whitespace().nth(37).ok_or("no priority")?.parse()?)
}

#[test]
fn processes_run_with_the_scheduling_of_their_graph_file() -> Outcome {
    let last = fs::read_to_string("/proc/self/status")?;
    let mine = last
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"))
        .ok_or("no processors")?
        .trim()
        .to_owned();
    let first: usize = mine.split([',', '-']).next().ok_or("no processor")?.parse()?;
    let launched = launched_with(
        &format!(
            "[processes.controller.scheduling]\nprocessors = [{first}]\nreal_time_priority = 7\n\
             [processes.plant.scheduling]\nreal_time_priority = 0\nlock_memory = false\n"
        ),
        &[],
    );
    // Where priorities or locked memory are not permitted, the other test checks the report.
    let launched = launched?;
    let driving = launched.wait_for_controller(1);
    if process::may_go_first() {
        driving?;
        let (controller, plant) =
            (launched.process("controller", None)?, launched.process("plant-sim", None)?);
        assert_eq!(
            (status(controller, "Cpus_allowed_list")?, status(plant, "Cpus_allowed_list")?),
            (first.to_string(), mine)
        );
        assert_eq!((priority(controller)?, priority(plant)?), (7, 0));
        assert_ne!(status(controller, "VmLck")?, "0 kB");
        assert_eq!(status(plant, "VmLck")?, "0 kB");
    } else {
        assert!(
            driving.is_err_and(|error| error.to_string().contains("scheduling.real_time_priority"))
        );
    }
    Ok(())
}

#[test]
fn a_scheduling_that_is_not_permitted_is_reported_before_the_robot_moves() -> Outcome {
    let powerless = [
        "setpriv",
        "--bounding-set=-ipc_lock,-sys_nice",
        "--inh-caps=-ipc_lock,-sys_nice",
        "prlimit",
        "--memlock=65536:65536",
        "--rtprio=0:0",
    ];
    let as_it_is: &[&str] = if rustix::process::geteuid().is_root() {
        &powerless
    } else {
        powerless.get(3..).unwrap_or_default()
    };
    for (table, before, parts) in [
        ("processors = [1023]", &[][..], ["scheduling.processors", "[1023]"]),
        ("lock_memory = true", as_it_is, ["scheduling.lock_memory", "CAP_IPC_LOCK"]),
        ("real_time_priority = 7", as_it_is, ["scheduling.real_time_priority = 7", "CAP_SYS_NICE"]),
    ] {
        let (ended, home) =
            launched_with(&format!("[processes.controller.scheduling]\n{table}\n"), before)?
                .end()?;
        assert_eq!(ended.status.code(), Some(1), "{table}: {}", ended.text);
        assert!(parts.iter().all(|part| ended.text.contains(part)), "{table}: {}", ended.text);
        assert!(!home.path().join("run/plant.log").exists(), "{table}: the robot was started");
    }
    Ok(())
}
