//! Promise: recorded commands of an earlier run move nothing, at any timing and while any process
//! is silent.

use bytemuck::Zeroable;
use graph::assembly::Assembly;
use graph::options::Options;
use process::read_settings;
use promises::oracle::{Limits, acquit};
use promises::{
    Launched, Message, Outcome, Record, graph_file, launch_command, repository, signal,
};
use protocol::message::{Coded, Command, FallbackLevel, Message as _, PlantState, Reason};
use protocol::topic::Topic;
use protocol::{VERSION, frame};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::{BTreeSet, VecDeque};
use std::error::Error;
use std::fs;
use std::time::Duration;
use transport::{Identity, Links, Ports, RawSink, Since, Source};

/// Ticks in which the recording is played.
const PLAYED: u64 = 120;
/// Tick at which the controller becomes silent, for far longer than another writer of its epoch
/// must wait to be accepted.
const SILENT_FROM: u64 = 40;
/// Length of the silence \[ticks\].
const SILENT_FOR: u64 = 40;
/// Commands of the same run are repeated so many periods later: their states are old then.
const AGAIN_AFTER: usize = 4;

/// A recorded command as it was sent.
fn command(message: &Message) -> Option<Command> {
    let fields = &message.fields;
    let mut command: Command = Zeroable::zeroed();
    let stamp = &mut command.stamp;
    (stamp.writer, stamp.epoch, stamp.sequence) =
        (message.stamp("writer"), message.stamp("epoch"), message.stamp("sequence"));
    (stamp.tick, stamp.sent_nanos) = (message.stamp("tick"), message.stamp("sent_nanos"));
    (stamp.version, stamp.kind) = (VERSION, Command::KIND);
    (command.plant_epoch, command.model_version) =
        (message.count("plant_epoch"), message.count("model_version"));
    let row = |row: &Value| {
        <[f64; 3]>::try_from(row.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<_>>>()?)
            .ok()
    };
    command.input = row(&fields["input"])?;
    for (place, input) in command.tail.iter_mut().zip(fields["tail"].as_array()?) {
        *place = row(input)?;
        command.tail_len += 1;
    }
    command.fallback_level = FallbackLevel::of_word(message.word("fallback_level"))?.code();
    Some(command)
}

/// An attacker that may publish commands, and has recordings.
struct Player {
    states: Source<PlantState>,
    commands: Source<Command>,
    sink: RawSink,
    recording: VecDeque<Command>,
    /// The last commands of the controller of this run.
    earlier: VecDeque<Command>,
    played: u64,
}

impl Player {
    fn join(links: &Links, recording: Vec<Command>) -> Result<Self, Box<dyn Error>> {
        let ports = Ports::open(links, Identity::new(0))?;
        let (states, commands, sink) = (
            ports.source(Since::Joining)?,
            ports.source(Since::Joining)?,
            ports.raw_sink(Topic::Command)?,
        );
        Ok(Self {
            states,
            commands,
            sink,
            recording: recording.into(),
            earlier: VecDeque::new(),
            played: 0,
        })
    }

    /// Waits a little for the next state, and plays the answer to its tick from the recorded run.
    /// Returns the tick, if a state arrived.
    fn play(&mut self) -> Result<Option<u64>, Box<dyn Error>> {
        self.states.wait(Duration::from_millis(20))?;
        let Some(state) = self.states.next()? else { return Ok(None) };
        let tick = state.stamp.tick;
        while let Some(due) = self.recording.pop_front_if(|command| command.stamp.tick <= tick) {
            self.say(&due)?;
            self.played += 1;
        }
        while let Some(command) = self.commands.next()? {
            // It receives its own commands, too.
            if command.plant_epoch == state.stamp.epoch {
                self.earlier.push_back(command);
            }
        }
        while self.earlier.len() > AGAIN_AFTER {
            if let Some(old) = self.earlier.pop_front() {
                self.say(&old)?;
            }
        }
        Ok(Some(tick))
    }

    fn say(&mut self, command: &Command) -> Outcome {
        let mut bytes = vec![0; command.byte_len()];
        frame::encode(command, &mut bytes);
        Ok(self.sink.send_raw(&bytes)?)
    }
}

/// The commands of the controller of a run in real time.
fn recording(graph: &str) -> Result<Vec<Command>, Box<dyn Error>> {
    let (ended, home) =
        Launched::graph(graph, &["--duration", &(PLAYED / 10).to_string()])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    let commands: Vec<Command> = record.of("command").filter_map(command).collect();
    assert_eq!(commands.len(), record.of("command").count());
    assert!(
        commands
            .iter()
            .filter(|command| command.fallback_level == FallbackLevel::FreshPlan.code())
            .count() as u64
            > PLAYED / 2,
        "it drove"
    );
    Ok(commands)
}

/// Launches a graph whose launcher does not kill a controller that hangs.
fn launch(graph: &str) -> Result<Launched, Box<dyn Error>> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let text = fs::read_to_string(graph_file(graph))?
        .replace("\"../", &format!("\"{}/deploy/", repository().display()));
    let text = text.replace("[processes.controller]\n", "")
        + "\n[processes.controller]\nhung_after_millis = 600000\n";
    let file = home.path().join("graph.toml");
    fs::write(&file, text)?;
    let command = launch_command(
        &file,
        &home.path().join("run"),
        &["--duration", &(PLAYED / 10 + 10).to_string()],
    )?;
    Launched::by(command, home)
}

/// Plays the answers of one run to the states of another run of the same robot, while its own
/// controller publishes and while it is silent.
#[test]
fn a_recording_played_in_a_later_run_moves_nothing() -> Outcome {
    let recording = recording("local")?;
    let strangers: BTreeSet<u64> = recording.iter().map(|command| command.stamp.writer).collect();
    let launched = launch("local")?;
    let file = launched.folder().join("settings/recorder.toml");
    let mut links = None;
    launched.wait_until("the links of the graph", || {
        links = read_settings::<recorder::settings::Settings>(&file)
            .ok()
            .map(|settings| settings.run.links);
        links.is_some()
    })?;
    // It joins before the controller: the first writer of an epoch would be accepted.
    let mut player = Player::join(&links.ok_or("no links")?, recording)?;
    // Meanwhile only the recording publishes commands.
    let mut next = Some((SILENT_FROM, Signal::STOP));
    let mut play = || -> Result<bool, Box<dyn Error>> {
        let Some(tick) = player.play()? else { return Ok(false) };
        if let Some((_, due)) = next.take_if(|(at, _)| *at <= tick) {
            signal(launched.process("controller", None)?, due)?;
            next = (due == Signal::STOP).then_some((tick + SILENT_FOR, Signal::CONT));
        }
        Ok(tick >= PLAYED)
    };
    let mut failed = None;
    launched.wait_until("that the recording is over", || {
        play().unwrap_or_else(|error| {
            failed = Some(error.to_string());
            true
        })
    })?;
    assert_eq!(failed, None);
    let played = player.played;
    assert!(played > PLAYED * 9 / 10, "{played} commands were played");
    drop(player);
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);

    let run = home.path().join("run");
    let record = Record::read(&run)?;
    acquit(&record, &Limits::of(&Assembly::read(&Options::of_graph(&graph_file("local")))?))?;
    let acted: Vec<u64> = record
        .of("truth")
        .filter(|truth| strangers.contains(&truth.count("acting_writer")))
        .map(|truth| truth.stamp("tick"))
        .collect();
    assert!(acted.is_empty(), "something recorded acted in ticks {acted:?}");
    // The gate has received every one of them, and logs why none may act.
    let log = fs::read_to_string(run.join("plant.log"))?;
    let lines = log.lines().filter(|line| line.contains(Reason::OldPlantEpoch.text()));
    let refused: u64 =
        lines.filter_map(|line| line.split_once("count=")?.1.trim().parse::<u64>().ok()).sum();
    assert_eq!(refused, played);
    let counted = record.of("state").next_back().ok_or("no state")?;
    assert!(counted.count("refused") >= played, "{} refused of {played}", counted.count("refused"));
    let recorded =
        record.of("command").filter(|command| strangers.contains(&command.stamp("writer"))).count()
            as u64;
    assert_eq!(recorded, played, "the recorder has received them");
    let braked =
        record.of("state").filter(|state| state.word("fallback_level") == "brake").count() as u64;
    assert!(
        braked > SILENT_FOR / 2,
        "nobody was silent: nothing was shown in {braked} periods on the brake"
    );
    assert_eq!(counted.word("fallback_level"), "fresh plan", "its own controller drives");
    Ok(())
}
