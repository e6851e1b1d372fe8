//! The harness of the promises: real processes, launched as a user would, and their records.
//!
//! Every launch has a temporary folder of its own for its files and its run, so that tests run side
//! by side.

mod browser;
pub mod decoders;
mod launched;
mod python;
mod reader;
mod screen;

pub use browser::Browser;
pub use drill::firmware;
pub use drill::hosts::Hosts;
pub use drill::measure::excuse;
pub use drill::oracle;
pub use drill::port;
pub use drill::record::{Message, Record};
pub use drill::tracking;
pub use launched::{Ended, Launched};
pub use python::{python, text_of};
pub use reader::Reader;
pub use screen::Screen;

use runs::registry;
use rustix::process::{Pid, Signal, getuid, kill_process};
use std::error::Error;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::thread;
use std::time::{Duration, Instant};

/// Result of a test.
pub type Outcome = Result<(), Box<dyn Error>>;

/// Time for an event that must happen, before the test fails. Far longer than it takes.
pub const GIVES_UP_AFTER: Duration = Duration::from_mins(2);

/// The repository.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("/"))
}

/// Copies the folder `from`, with what is in it.
///
/// # Errors
/// The error of the file system.
pub fn copy_folder(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)?.flatten() {
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_folder(&entry.path(), &target)?;
        } else {
            fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}

/// The folder of the binaries, built once, in the profile of the tests.
///
/// # Errors
/// A sentence, if they cannot be built.
pub fn binaries() -> Result<&'static Path, Box<dyn Error>> {
    static FOLDER: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| build().map_err(|error| error.to_string()));
    folder.as_deref().map_err(|error| error.clone().into())
}

fn build() -> io::Result<PathBuf> {
    let test = std::env::current_exe()?;
    let folder = test.parent().and_then(Path::parent).ok_or(io::ErrorKind::NotFound)?;
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--quiet", "--workspace", "--bins"]).current_dir(repository());
    cargo.env("CARGO_TARGET_DIR", folder.parent().unwrap_or(folder));
    // The variables that cargo sets for the package of this test. A dependency that reads one of
    // them would be rebuilt, with everything that depends on it.
    let is_of_package =
        |name: &str| name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_");
    for (name, _) in
        std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(is_of_package))
    {
        cargo.env_remove(name);
    }
    if folder.ends_with("release") {
        cargo.arg("--release");
    } else {
        // With the tests, which are already built, the libraries have the same features as theirs,
        // and are not built again with others.
        cargo.args(["--tests", "--examples"]);
    }
    if !cargo.status()?.success() {
        return Err(io::Error::other("the binaries could not be built"));
    }
    Ok(folder.to_path_buf())
}

/// The graph in `deploy/graphs/` that is called `graph`.
pub fn graph_file(graph: &str) -> PathBuf {
    repository().join("deploy/graphs").join(graph).with_extension("toml")
}

/// The graph in `deploy/graphs/` that is called `graph`, with these tables in place of those of its
/// processes: a file in `home`.
///
/// # Errors
/// If there is no such graph, or the file cannot be written.
pub fn graph_with(graph: &str, tables: &str, home: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let text = fs::read_to_string(graph_file(graph))?;
    let kept = text.split("\n[processes.").next().unwrap_or_default();
    let kept = kept.replace("\"../", &format!("\"{}/", repository().join("deploy").display()));
    let file = home.join("graph.toml");
    fs::write(&file, format!("{kept}\n{tables}"))?;
    Ok(file)
}

/// `coxswain launch GRAPH --out OUT OPTIONS…`.
///
/// # Errors
/// If the binaries cannot be built.
pub fn launch_command(
    graph: &Path,
    out: &Path,
    options: &[&str],
) -> Result<Command, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.arg("launch").arg(graph).arg("--out").arg(out).args(options);
    Ok(command)
}

/// Sends a signal to a process that this test started.
///
/// # Errors
/// If there is no such process.
pub fn signal(pid: u32, signal: Signal) -> Outcome {
    let pid = Pid::from_raw(i32::try_from(pid)?).ok_or("no such process")?;
    Ok(kill_process(pid, signal)?)
}

/// Removes what a launch with this home could not remove, as the next launch there does.
///
/// # Errors
/// If something is left, or lives.
pub fn sweep_after(home: &Path) -> Outcome {
    let base = home.join(format!("coxswain-{}", getuid().as_raw()));
    let (_, complaints) = registry::sweep_stale(&base);
    if !complaints.is_empty() || !registry::living(&base).is_empty() || base.exists() {
        return Err(format!("{} is not clean: {complaints:?}", base.display()).into());
    }
    Ok(())
}

/// Waits until `condition` holds.
///
/// # Errors
/// If it never does. The error names the awaited condition.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) -> Outcome {
    let begin = Instant::now();
    while !condition() {
        if begin.elapsed() > GIVES_UP_AFTER {
            return Err(format!("waited {GIVES_UP_AFTER:?} for {what}, in vain").into());
        }
        thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}

/// Whether a process exists and is no zombie. A process with a thread that is still ending still
/// holds its files and locks.
pub fn lives(pid: u32) -> bool {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).map_or(0, Iterator::count);
    threads > 1
        || fs::read_to_string(format!("/proc/{pid}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}

/// Files in shared memory that belong to the graphs called `names`.
pub fn shared_memory_of(names: &[String]) -> Vec<String> {
    let files = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    let all = files.filter_map(|file| file.file_name().into_string().ok());
    all.filter(|file| names.iter().any(|name| file.contains(name.as_str()))).collect()
}

/// The processes that `pid` started, and those that they started, the oldest first.
fn descendants(pid: u32) -> Vec<u32> {
    let children = children(pid);
    let further = children.iter().copied().flat_map(descendants).collect::<Vec<u32>>();
    let mut all = [children, further].concat();
    all.sort_unstable();
    all
}

fn children(pid: u32) -> Vec<u32> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let mut children: Vec<u32> = tasks
        .filter_map(|task| fs::read_to_string(task.path().join("children")).ok())
        .flat_map(|children| {
            children.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<u32>>()
        })
        .filter(|&pid| lives(pid))
        .collect();
    children.sort_unstable();
    children
}

fn name_of(pid: u32) -> Option<String> {
    Some(fs::read_to_string(format!("/proc/{pid}/comm")).ok()?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::{Outcome, repository};
    use std::fs;

    /// Cargo.toml lists the test targets. A file that is missing there does not run.
    #[test]
    fn every_file_of_this_folder_is_a_test_or_a_module() -> Outcome {
        let folder = repository().join("tests");
        let (targets, modules) = (
            fs::read_to_string(folder.join("Cargo.toml"))?,
            fs::read_to_string(folder.join("lib.rs"))?,
        );
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            let (name, stem) = (path.file_name(), path.file_stem());
            let (Some(name), Some(stem)) = (name, stem) else { continue };
            let (name, stem) = (name.to_string_lossy(), stem.to_string_lossy());
            let is_listed = targets.contains(&format!("path = \"{name}\""))
                || modules.contains(&format!("mod {stem};"));
            assert!(!name.ends_with(".rs") || is_listed, "tests/{name} is not run");
        }
        Ok(())
    }
}
