//! A launched graph, what it prints and logs, and its end.

use super::{Outcome, descendants, graph_file, launch_command, lives, name_of, signal, wait_until};
use rustix::process::Signal;
use std::error::Error;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use tempfile::TempDir;

/// A launched graph.
pub struct Launched {
    child: Child,
    home: TempDir,
    /// Its output, in a file without a name.
    output: File,
}

/// How a launch ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit status.
    pub status: ExitStatus,
    /// Its output.
    pub text: String,
}

impl Launched {
    /// Launches the local graph with `options`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn new(options: &[&str]) -> Result<Self, Box<dyn Error>> {
        Self::at_home(tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?, options)
    }

    /// Launches the graph in `deploy/graphs/` that is called `graph` with `options`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn graph(graph: &str, options: &[&str]) -> Result<Self, Box<dyn Error>> {
        let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        let command = launch_command(&graph_file(graph), &home.path().join("run"), options)?;
        Self::by(command, home)
    }

    /// Launches the local graph in a home that other launches may have used before.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn at_home(home: TempDir, options: &[&str]) -> Result<Self, Box<dyn Error>> {
        let command = launch_command(&graph_file("local"), &home.path().join("run"), options)?;
        Self::by(command, home)
    }

    /// Launches by `command`, whose arguments put the run into the folder `run` of `home`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn by(mut command: Command, home: TempDir) -> Result<Self, Box<dyn Error>> {
        let output = tempfile::tempfile()?;
        command
            .env("TMPDIR", home.path())
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output.try_clone()?);
        Ok(Self { child: command.spawn()?, home, output })
    }

    /// The run's folder.
    pub fn folder(&self) -> PathBuf {
        self.home.path().join("run")
    }

    /// Folder of the graph's files while it runs.
    pub fn home(&self) -> &Path {
        self.home.path()
    }

    /// The launcher.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The process of the program `name` that this launcher started last, as soon as there is one
    /// other than `not`.
    ///
    /// # Errors
    /// If there is none in time.
    pub fn process(&self, name: &str, not: Option<u32>) -> Result<u32, Box<dyn Error>> {
        let mut found = None;
        self.wait_until(&format!("a process {name}"), || {
            found = descendants(self.pid())
                .into_iter()
                .rev()
                .find(|&pid| Some(pid) != not && name_of(pid).as_deref() == Some(name));
            found.is_some()
        })?;
        found.ok_or_else(|| format!("no process {name}").into())
    }

    /// All processes of the graph that live at this moment.
    pub fn processes(&self) -> Vec<u32> {
        descendants(self.pid())
    }

    /// Waits until the log of `name` contains `text` at least `times` times.
    ///
    /// # Errors
    /// If it does not in time.
    pub fn wait_for_log(&self, name: &str, text: &str, times: usize) -> Outcome {
        let file = self.folder().join(name).with_extension("log");
        self.wait_until(&format!("{text:?} in {}", file.display()), || {
            fs::read_to_string(&file).is_ok_and(|log| log.matches(text).count() >= times)
        })
    }

    /// Waits until the controllers of this launch have found a plant to answer, this many times.
    ///
    /// # Errors
    /// If they do not in time.
    pub fn wait_for_controller(&self, times: usize) -> Outcome {
        self.wait_for_log("controller", "controller_epoch=", times)
    }

    /// The name of the graph, once its first process has received it.
    ///
    /// # Errors
    /// If it never is.
    pub fn graph_name(&self) -> Result<String, Box<dyn Error>> {
        self.told("recorder", "graph")
    }

    /// The value of the setting `key` of the process `name`, a single text, once the process has
    /// received it.
    ///
    /// # Errors
    /// If it never is.
    pub fn told(&self, name: &str, key: &str) -> Result<String, Box<dyn Error>> {
        let (host, name) = name.rsplit_once('/').unwrap_or(("", name));
        let settings = self.folder().join(host).join("settings");
        let (file, key) = (settings.join(name).with_extension("toml"), format!("{key} = "));
        let mut value = None;
        self.wait_until(&format!("{key:?} in {}", file.display()), || {
            let text = fs::read_to_string(&file).unwrap_or_default();
            value = text.lines().find_map(|line| {
                Some(line.strip_prefix(&key)?.trim_matches(['[', ']', '"']).to_owned())
            });
            value.is_some()
        })?;
        value.ok_or_else(|| format!("nothing under {key:?}").into())
    }

    /// The rest of the output line that contains `what`, once it was printed.
    ///
    /// # Errors
    /// If it never is.
    pub fn told_a_person(&self, what: &str) -> Result<String, Box<dyn Error>> {
        let mut rest = None;
        self.wait_until(&format!("{what:?} on the terminal"), || {
            let text = self.text().unwrap_or_default();
            rest = text.lines().find_map(|line| Some(line.split_once(what)?.1.to_owned()));
            rest.is_some()
        })?;
        rest.ok_or_else(|| format!("nothing of {what:?}").into())
    }

    /// Endpoint of the gateway, once it listens.
    ///
    /// # Errors
    /// If it never does.
    pub fn gateway_endpoint(&self) -> Result<String, Box<dyn Error>> {
        self.wait_for_log("gateway", "endpoints=", 1)?;
        let log = fs::read_to_string(self.folder().join("gateway.log"))?;
        let endpoint = log
            .lines()
            .find_map(|line| line.split_once("endpoints="))
            .ok_or("no endpoint was told")?;
        Ok(endpoint.1.trim().to_owned())
    }

    /// Address of the live page, once it is served.
    ///
    /// # Errors
    /// If it never is.
    pub fn page_address(&self) -> Result<String, Box<dyn Error>> {
        self.wait_for_log("gateway", "address=", 1)?;
        let log = fs::read_to_string(self.folder().join("gateway.log"))?;
        let address = log
            .lines()
            .find_map(|line| line.split_once("address="))
            .ok_or("no address was told")?;
        Ok(format!("http://{}/", address.1.trim()))
    }

    /// Waits until `condition` holds, as long as the launch runs.
    ///
    /// # Errors
    /// If it never does. The error names the awaited condition and, for a launch that has ended,
    /// its output.
    pub fn wait_until(&self, what: &str, mut condition: impl FnMut() -> bool) -> Outcome {
        let mut holds = false;
        wait_until(what, || {
            // Checked first, so that its last actions count.
            let over = !lives(self.pid());
            holds = condition();
            holds || over
        })?;
        if holds {
            Ok(())
        } else {
            Err(format!("the launch has ended without {what}: {}", self.text()?).into())
        }
    }

    /// The output so far.
    fn text(&self) -> io::Result<String> {
        let mut text = vec![0; usize::try_from(self.output.metadata()?.len()).unwrap_or(0)];
        // The launch writes at the offset that this file shares with its own; reading at an offset
        // does not move it.
        self.output.read_exact_at(&mut text, 0)?;
        Ok(String::from_utf8_lossy(&text).into_owned())
    }

    /// Waits until it has ended by itself, and returns its home.
    ///
    /// # Errors
    /// If it does not end in time.
    pub fn end(mut self) -> Result<(Ended, TempDir), Box<dyn Error>> {
        let mut status = None;
        wait_until("the end of the launch", || {
            status = self.child.try_wait().ok().flatten();
            status.is_some()
        })?;
        let text = self.text()?;
        let home = std::mem::replace(&mut self.home, TempDir::new_in("/tmp")?);
        Ok((Ended { status: status.ok_or("no status")?, text }, home))
    }
}

impl Drop for Launched {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = signal(self.child.id(), Signal::TERM);
            let _ = wait_until("the end of a launch that is given up", || {
                !matches!(self.child.try_wait(), Ok(None))
            });
        }
    }
}
