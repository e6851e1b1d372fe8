//! Registry of the running graphs on this machine, and removal of the files of launchers that have
//! ended.
//!
//! ```text
//! <temporary folder>/coxswain-<user id>/ for this user only
//!     <graph id>.toml                    its launcher: process id and start time of that process
//!     <graph id>/                        files and sockets of its links; `run`: its run directory
//! ```
//! The system reuses a process id, but not together with the same start time. A graph whose
//! launcher has ended is stale. The next launcher removes it, even if SIGKILL ended all processes
//! of that graph.

use crate::private::{self, NotPrivate};
use process::atomic_file;
use serde::{Deserialize, Serialize};
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{env, fs, thread};
use transport::{Identity, Links, sweep};

/// Longest time for the processes of a graph to end after its launcher has ended.
const DYING: Duration = Duration::from_millis(500);

/// Why a graph cannot be registered.
#[derive(Debug, thiserror::Error)]
pub enum RegistryError {
    /// Another user could read or change the registry.
    #[error("{0}; remove it, or set TMPDIR")]
    NotPrivate(#[from] NotPrivate),
    /// Error of the file system.
    #[error("{}: {source}", path.display())]
    FileSystem {
        /// File or directory of the error.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// The file with the path of the run directory.
const RUN: &str = "run";

/// Launcher of a graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Launcher {
    pid: u32,
    /// Start time of the process, in clock ticks since the machine started.
    start_ticks: u64,
}

/// The entry of one graph in the registry of this machine.
#[derive(Debug)]
pub struct GraphEntry {
    base: PathBuf,
    id: String,
}

/// The directory of all graphs of this user.
pub fn base() -> PathBuf {
    env::temp_dir().join(format!("coxswain-{}", rustix::process::getuid().as_raw()))
}

impl GraphEntry {
    /// Registers a graph of this process below `base`, under a new name.
    ///
    /// # Errors
    /// [`RegistryError`].
    pub fn register(base: &Path) -> Result<Self, RegistryError> {
        let entry = Self { base: base.to_path_buf(), id: new_id() };
        let launcher = Launcher::this().map_err(|source| RegistryError::FileSystem {
            path: "/proc/self/stat".into(),
            source,
        })?;
        // The launcher that removes the last graph removes the base, perhaps between these two
        // steps.
        let mut attempts_left = 5;
        loop {
            private::make(base)?;
            match entry.sign(launcher) {
                Err(error) if error.kind() == io::ErrorKind::NotFound && attempts_left > 0 => {
                    attempts_left -= 1;
                }
                Err(source) => {
                    return Err(RegistryError::FileSystem { path: entry.launcher_file(), source });
                }
                Ok(()) => break,
            }
        }
        private::make(&entry.root())?;
        Ok(entry)
    }

    /// Name of the graph, unique on this machine.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Directory for files and sockets of its links.
    pub fn root(&self) -> PathBuf {
        self.base.join(&self.id)
    }

    /// Stores the path of its run directory for other commands.
    ///
    /// # Errors
    /// Error of the file system.
    pub fn note_run(&self, folder: &Path) -> io::Result<()> {
        atomic_file::write(&self.root().join(RUN), folder.as_os_str().as_bytes())
    }

    /// Its run directory, once there is one.
    pub fn run_folder(&self) -> Option<PathBuf> {
        fs::read(self.root().join(RUN)).ok().map(|bytes| PathBuf::from(OsString::from_vec(bytes)))
    }

    /// Whether its launcher runs.
    pub fn is_living(&self) -> bool {
        Launcher::of(&self.launcher_file()).is_some_and(Launcher::lives)
    }

    /// Removes everything that is left of the graph, unless a process still uses it. From now on its
    /// launcher counts as ended: commands that watch the graph end.
    ///
    /// # Errors
    /// A sentence.
    pub fn remove(self) -> Result<(), String> {
        // If that fails, those commands end with this process.
        let _ = self.sign(Launcher::ENDED);
        self.clear_in_time()
    }

    /// A process that ends may take a moment.
    fn clear_in_time(&self) -> Result<(), String> {
        let begin = Instant::now();
        loop {
            let cleared = self.clear();
            if cleared.is_ok() || begin.elapsed() >= DYING {
                return cleared;
            }
            thread::sleep(DYING / 20);
        }
    }

    fn clear(&self) -> Result<(), String> {
        let report = sweep(&self.links()).map_err(|error| error.to_string())?;
        if report.living > 0 {
            return Err(format!(
                "graph {} has {} living members; the next launch sweeps it",
                self.id, report.living
            ));
        }
        let gone = |result: io::Result<()>| match result {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error.to_string()),
            _ => Ok(()),
        };
        gone(fs::remove_dir_all(self.root()))?;
        gone(fs::remove_file(self.launcher_file()))?;
        // Fails while other graphs are there.
        let _ = fs::remove_dir(&self.base);
        Ok(())
    }

    /// To remove a graph, only its name and root are needed.
    fn links(&self) -> Links {
        Links::on_this_machine(self.id.clone(), self.root(), false, 0)
    }

    fn launcher_file(&self) -> PathBuf {
        self.base.join(format!("{}.toml", self.id))
    }

    /// Writes the launcher's entry atomically.
    fn sign(&self, launcher: Launcher) -> io::Result<()> {
        let text = toml::to_string(&launcher).map_err(io::Error::other)?;
        atomic_file::write(&self.launcher_file(), text.as_bytes())
    }
}

/// Removes the graphs below `base` whose launcher has ended. Returns the number of removed graphs,
/// and an error text for each of the others.
pub fn sweep_stale(base: &Path) -> (usize, Vec<String>) {
    let mut removed = 0;
    let mut complaints = Vec::new();
    for entry in stale(base) {
        match entry.clear_in_time() {
            Ok(()) => removed += 1,
            Err(complaint) => complaints.push(complaint),
        }
    }
    (removed, complaints)
}

/// The graphs below `base` whose launcher runs.
pub fn living(base: &Path) -> Vec<GraphEntry> {
    signed(base, Launcher::lives)
}

/// The graphs below `base` whose launcher has ended.
fn stale(base: &Path) -> Vec<GraphEntry> {
    signed(base, |launcher| !launcher.lives())
}

/// The graphs below `base` whose launcher satisfies `wanted`.
fn signed(base: &Path, wanted: impl Fn(Launcher) -> bool) -> Vec<GraphEntry> {
    let entries = fs::read_dir(base).into_iter().flatten().flatten();
    let files = entries
        .map(|entry| entry.path())
        .filter(|path| path.extension() == Some(OsStr::new("toml")));
    let chosen = files.filter(|path| Launcher::of(path).is_some_and(&wanted));
    let ids = chosen.filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()));
    ids.map(|id| GraphEntry { base: base.to_path_buf(), id }).collect()
}

impl Launcher {
    /// No process has this number.
    const ENDED: Self = Self { pid: 0, start_ticks: 0 };

    fn this() -> io::Result<Self> {
        let pid = std::process::id();
        let start_ticks = start_ticks(pid).ok_or(io::ErrorKind::InvalidData)?;
        Ok(Self { pid, start_ticks })
    }

    /// The launcher in `file`, if the file is valid.
    fn of(file: &Path) -> Option<Self> {
        toml::from_str(&fs::read_to_string(file).ok()?).ok()
    }

    fn lives(self) -> bool {
        start_ticks(self.pid) == Some(self.start_ticks)
    }
}

/// Start time of a process, in clock ticks since the machine started; none if there is no such
/// process, or if it is a zombie.
fn start_ticks(pid: u32) -> Option<u64> {
    parse_stat(&fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

/// Field 22 of `/proc/<pid>/stat`. The name, field 2 in parentheses, may contain any characters,
/// also parentheses.
fn parse_stat(stat: &str) -> Option<u64> {
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut fields = after_name.split_ascii_whitespace();
    if matches!(fields.next()?, "Z" | "X") {
        return None;
    }
    fields.nth(18)?.parse().ok()
}

/// Eight random characters.
fn new_id() -> String {
    const DIGITS: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";
    let random = Identity::new(0).writer;
    (0..8)
        .map(|place| char::from(DIGITS[(random >> (5 * place)) as usize % DIGITS.len()]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn the_start_time_is_found_after_any_name() {
        let rest = "S 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 4242 20 21";
        assert_eq!(parse_stat(&format!("77 (a) b) {rest}")), Some(4242));
        assert_eq!(parse_stat(&format!("77 (dead) {}", rest.replacen('S', "Z", 1))), None);
        assert_eq!(parse_stat("77 (short) S 1 2"), None);
    }

    #[test]
    fn a_process_id_with_another_start_time_is_another_process() -> io::Result<()> {
        let this = Launcher::this()?;
        assert!(this.lives());
        assert!(
            !Launcher { start_ticks: this.start_ticks + 1, ..this }.lives(),
            "another process with the same id"
        );
        let mut child = std::process::Command::new("true").spawn()?;
        child.wait()?;
        assert!(!Launcher { pid: child.id(), ..this }.lives());
        Ok(())
    }

    #[test]
    fn only_graphs_of_ended_launchers_are_stale() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let base = folder.path().join("base");
        let living = GraphEntry::register(&base)?;
        let dead = GraphEntry::register(&base)?;
        dead.sign(Launcher { pid: std::process::id(), start_ticks: 0 })?;
        fs::write(base.join("garbage.toml"), "not a launcher")?;
        let found: Vec<String> = stale(&base).into_iter().map(|entry| entry.id).collect();
        assert_eq!(found, [dead.id()]);
        assert_eq!(sweep_stale(&base), (1, Vec::new()));
        assert!(!dead.root().exists() && !dead.launcher_file().exists());
        assert!(living.root().exists());
        Ok(())
    }

    #[test]
    fn the_last_removed_graph_leaves_no_files() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let base = folder.path().join("base");
        let (first, second) = (GraphEntry::register(&base)?, GraphEntry::register(&base)?);
        assert_ne!(first.id(), second.id());
        first.remove()?;
        assert!(second.root().is_dir());
        second.remove()?;
        assert!(!base.exists());
        Ok(())
    }

    #[test]
    fn a_folder_that_others_can_enter_is_refused() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let base = folder.path().join("base");
        fs::create_dir(&base)?;
        fs::set_permissions(&base, fs::Permissions::from_mode(0o755))?;
        assert!(matches!(GraphEntry::register(&base), Err(RegistryError::NotPrivate(_))));
        Ok(())
    }
}
