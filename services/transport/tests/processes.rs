//! Separate processes on shared memory, some of which are killed or stopped.
//!
//! Each test starts this binary again as its children. They act as `CHILD_ROLE` specifies, and are
//! killed in the end.

use bytemuck::Zeroable;
use protocol::message::{Command, Credit};
use protocol::topic::{OnTopic, Topic};
use rustix::process::{Pid, Signal, kill_process};
use std::env;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::Duration;
use tempfile::TempDir;
use transport::{Identity, Links, Ports, SendError, Since, Source, SweepReport, sweep};

type Outcome = Result<(), Box<dyn Error>>;

/// Longer than any test machine needs.
const LONG: Duration = Duration::from_mins(1);

const PATIENCE: Duration = Duration::from_millis(300);

/// A graph whose links children can join. It is removed in the end with all its remains.
struct Graph {
    links: Links,
    _folder: TempDir,
}

impl Graph {
    fn new(lock_step: bool) -> Result<Self, Box<dyn Error>> {
        static GRAPHS: AtomicU32 = AtomicU32::new(0);
        let folder = tempfile::tempdir()?;
        let graph = format!("p{}-{}", std::process::id(), GRAPHS.fetch_add(1, Ordering::Relaxed));
        Ok(Self { links: links(graph, lock_step, folder.path().join("r")), _folder: folder })
    }

    fn ports(&self) -> Result<Ports, Box<dyn Error>> {
        Ok(Ports::open(&self.links, Identity::new(1))?)
    }

    /// Starts a child, which is killed when the returned value is dropped.
    fn start(&self, role: &str, epoch: u64) -> Result<Killed, Box<dyn Error>> {
        let child = std::process::Command::new(env::current_exe()?)
            .args(["--exact", "child"])
            .env("CHILD_ROLE", role)
            .env("CHILD_GRAPH", &self.links.graph)
            .env("CHILD_ROOT", &self.links.root)
            .env("CHILD_LOCK_STEP", self.links.lock_step.to_string())
            .env("CHILD_EPOCH", epoch.to_string())
            .stdout(Stdio::null())
            .spawn()?;
        Ok(Killed { child })
    }

    /// Files that the graph has left in the file system.
    fn remains(&self) -> Result<Vec<PathBuf>, Box<dyn Error>> {
        let prefix = format!("cx.{}.", self.links.graph);
        let mut remains: Vec<PathBuf> =
            self.links.root.exists().then(|| self.links.root.clone()).into_iter().collect();
        for entry in fs::read_dir("/dev/shm")? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(&prefix) {
                remains.push(entry.path());
            }
        }
        Ok(remains)
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        // A failed test must leave no remains beside its message.
        let _ = sweep(&self.links);
    }
}

struct Killed {
    child: Child,
}

impl Killed {
    fn kill(mut self) -> Outcome {
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }

    fn signal(&self, signal: Signal) -> Outcome {
        Ok(kill_process(Pid::from_child(&self.child), signal)?)
    }
}

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn links(graph: String, lock_step: bool, root: PathBuf) -> Links {
    Links::on_this_machine(graph, root, lock_step, PATIENCE.as_millis() as u64)
}

/// Not a test, but the program of the children.
#[test]
fn child() -> Outcome {
    let Ok(role) = env::var("CHILD_ROLE") else {
        return Ok(());
    };
    let root = Path::new(&env::var("CHILD_ROOT")?).to_path_buf();
    let links = links(env::var("CHILD_GRAPH")?, env::var("CHILD_LOCK_STEP")?.parse()?, root);
    let ports = Ports::open(&links, Identity::new(env::var("CHILD_EPOCH")?.parse()?))?;
    match role.as_str() {
        "commands" => say_commands(&ports),
        "credits" => answer_with_credits(&ports),
        other => Err(format!("no such role: {other}").into()),
    }
}

/// Commands without end, one per millisecond.
fn say_commands(ports: &Ports) -> Outcome {
    let mut commands = ports.sink::<Command>()?;
    for tick in 1.. {
        commands.send(&mut command(tick))?;
        thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

/// A credit for each command.
fn answer_with_credits(ports: &Ports) -> Outcome {
    let mut commands = ports.source::<Command>(Since::Joining)?;
    let mut credits = ports.sink::<Credit>()?;
    credits.send(&mut Credit::zeroed())?;
    loop {
        commands.wait(Duration::from_millis(20))?;
        while let Some(command) = commands.next()? {
            credits.send(&mut Credit { through_tick: command.stamp.tick, ..Credit::zeroed() })?;
        }
        credits.refresh()?;
    }
}

#[test]
fn a_killed_writer_is_replaced_by_its_successor() -> Outcome {
    let graph = Graph::new(false)?;
    let mut commands = graph.ports()?.source::<Command>(Since::Joining)?;
    // More instances than the topic has places for writers.
    for epoch in 1..=7 {
        let writer = graph.start("commands", epoch)?;
        let received = until(&mut commands, |command| {
            command.stamp.epoch == epoch && command.stamp.tick >= 5
        })?;
        assert_eq!(received.stamp.sequence, received.stamp.tick, "its sequence started at 1");
        writer.kill()?;
    }
    assert_eq!(commands.tally().refused, 0);
    Ok(())
}

#[test]
fn a_killed_reader_is_replaced_by_its_successor() -> Outcome {
    let graph = Graph::new(false)?;
    let ports = graph.ports()?;
    let mut credits = ports.source::<Credit>(Since::Joining)?;
    let mut commands = ports.sink::<Command>()?;
    // More instances than the topic has places for readers.
    for tick in 1..=9 {
        let reader = graph.start("credits", tick)?;
        until(&mut credits, |credit| credit.stamp.epoch == tick)?;
        commands.send(&mut command(tick))?;
        until(&mut credits, |credit| credit.stamp.epoch == tick && credit.through_tick == tick)?;
        reader.kill()?;
    }
    Ok(())
}

#[test]
fn a_killed_reader_delays_a_lossless_writer_no_longer_than_its_patience() -> Outcome {
    let graph = Graph::new(true)?;
    let ports = graph.ports()?;
    let mut credits = ports.source::<Credit>(Since::Joining)?;
    let mut commands = ports.sink::<Command>()?;
    let reader = graph.start("credits", 1)?;
    until(&mut credits, |_| true)?;
    commands.send(&mut command(1))?;
    until(&mut credits, |credit| credit.through_tick == 1)?;
    reader.kill()?;

    let mut failures = Vec::new();
    for tick in 2..=3 * Topic::Command.quality(true).depth as u64 {
        if let Err(error) = commands.send(&mut command(tick)) {
            failures.push(error);
        }
    }
    assert_eq!(
        failures,
        [SendError::NoRoom { topic: Topic::Command, waited: PATIENCE }],
        "then it is known to be dead"
    );

    let _successor = graph.start("credits", 2)?;
    until(&mut credits, |credit| credit.stamp.epoch == 2)?;
    commands.send(&mut command(10_000))?;
    until(&mut credits, |credit| credit.through_tick == 10_000)?;
    Ok(())
}

#[test]
fn a_stopped_reader_does_not_stop_the_control_path() -> Outcome {
    let graph = Graph::new(false)?;
    let ports = graph.ports()?;
    let mut credits = ports.source::<Credit>(Since::Joining)?;
    let mut commands = ports.sink::<Command>()?;
    let reader = graph.start("credits", 1)?;
    until(&mut credits, |_| true)?;
    reader.signal(Signal::STOP)?;
    for tick in 1..=20_000 {
        commands.send(&mut command(tick))?;
    }
    reader.signal(Signal::CONT)?;
    until(&mut credits, |credit| credit.through_tick == 20_000)?;
    Ok(())
}

#[test]
fn a_sweep_removes_everything_of_dead_processes() -> Outcome {
    let graph = Graph::new(false)?;
    let (writer, reader) = (graph.start("commands", 1)?, graph.start("credits", 1)?);
    {
        let mut credits = graph.ports()?.source::<Credit>(Since::Joining)?;
        until(&mut credits, |credit| credit.through_tick > 0)?;
    }
    writer.kill()?;
    reader.kill()?;
    assert!(!graph.remains()?.is_empty(), "there is something to remove");

    let report = sweep(&graph.links)?;
    assert_eq!((report.living, report.dead), (0, 2));
    assert_eq!(graph.remains()?, Vec::<PathBuf>::new());
    assert_eq!(sweep(&graph.links)?, SweepReport::default(), "once more does no harm");
    Ok(())
}

#[test]
fn a_sweep_spares_living_processes() -> Outcome {
    let graph = Graph::new(false)?;
    let (writer, doomed) = (graph.start("commands", 1)?, graph.start("commands", 2)?);
    {
        let mut commands = graph.ports()?.source::<Command>(Since::Joining)?;
        until(&mut commands, |command| command.stamp.epoch == 1)?;
        until(&mut commands, |command| command.stamp.epoch == 2)?;
    }
    writer.signal(Signal::STOP)?;
    doomed.kill()?;
    assert_eq!(
        sweep(&graph.links)?,
        SweepReport { living: 1, dead: 1, files: 0 },
        "a stopped process lives"
    );
    writer.signal(Signal::CONT)?;
    let mut commands = graph.ports()?.source::<Command>(Since::Joining)?;
    until(&mut commands, |command| command.stamp.epoch == 1)?;
    Ok(())
}

#[test]
fn a_folder_that_holds_something_else_survives_the_sweep() -> Outcome {
    let graph = Graph::new(false)?;
    drop(graph.ports()?.sink::<Command>()?);
    let note = graph.links.root.join("note.txt");
    fs::write(&note, "mine")?;
    sweep(&graph.links)?;
    assert_eq!(graph.remains()?, std::slice::from_ref(&graph.links.root));
    assert_eq!(fs::read_dir(&graph.links.root)?.count(), 1);
    fs::remove_file(note)?;
    Ok(())
}

/// A command that answers `tick`.
fn command(tick: u64) -> Command {
    let mut command = Command::zeroed();
    command.stamp.tick = tick;
    command
}

/// Reads until a message satisfies the condition.
fn until<T: OnTopic>(
    source: &mut Source<T>,
    wanted: impl Fn(&T) -> bool,
) -> Result<T, Box<dyn Error>> {
    loop {
        if !source.wait(LONG)? {
            return Err("nothing comes any more".into());
        }
        while let Some(message) = source.next()? {
            if wanted(&message) {
                return Ok(message);
            }
        }
    }
}
