//! The recorder in a graph of publishers: every message is in the record, or counted as lost.

#[path = "said/graph.rs"]
mod graph;

use bytemuck::Zeroable;
use graph::{Graph, SNAPSHOT_TICKS};
use process::{Pace, Run, Stop};
use protocol::message::{Credit, FallbackLevel, Health, Participant};
use recorder::run::RecorderError;
use recorder::segment::{self, RecordError};
use recorder::settings::Settings;
use recorder::summary::Summary;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use std::{fs, io};
use tempfile::TempDir;
use transport::{Exchange, Identity, Links, Ports, Since};

const PATIENCE: Duration = Duration::from_secs(20);

/// Interval of a process's health.
const HEARTBEAT: Duration = Duration::from_millis(100);

fn settings(folder: &Path, pace: Pace, restarted: bool) -> Settings {
    let lock_step = pace == Pace::LockStep;
    let links = Links::on_this_machine("test", folder, lock_step, 1000);
    Settings { run: Run { epoch_floor: 1, restarted, ..Run::new(folder, 100_000_000, links) } }
}

/// A recorder on a thread of its own.
struct Recording {
    stop: Stop,
    thread: JoinHandle<Result<Summary, RecorderError>>,
}

impl Recording {
    fn start(exchange: &Exchange, settings: Settings) -> Self {
        let stop = Stop::new();
        let (exchange, stop_of_thread) = (exchange.clone(), stop.clone());
        let thread = thread::spawn(move || {
            recorder::run::run(
                &Ports::in_memory(&exchange, Identity::new(1)),
                &settings,
                &stop_of_thread,
            )
        });
        Self { stop, thread }
    }

    fn stop(self) -> Result<Summary, Box<dyn Error>> {
        self.stop.request();
        Ok(self.thread.join().map_err(|_| "the recorder panicked")??)
    }
}

/// Messages by topic in one file, by the public reader.
fn stored(path: &Path) -> Result<BTreeMap<String, u64>, Box<dyn Error>> {
    let mut counts = BTreeMap::new();
    let bytes = fs::read(path)?;
    for message in mcap::MessageStream::new(&bytes)? {
        let message = message?;
        assert_eq!(message.channel.message_encoding, "json");
        assert_eq!(
            message.channel.schema.as_ref().map(|schema| schema.encoding.as_str()),
            Some("jsonschema")
        );
        assert!(message.log_time > 0 && message.log_time == message.publish_time);
        *counts.entry(message.channel.topic.clone()).or_default() += 1;
    }
    Ok(counts)
}

/// Waits for the first health of the recorder: from then on it receives everything.
fn wait_until_it_listens(
    ports: &Ports,
    exchange: &Exchange,
    settings: Settings,
) -> Result<Recording, Box<dyn Error>> {
    let mut healths = ports.source::<Health>(Since::Joining)?;
    let recording = Recording::start(exchange, settings);
    assert!(healths.wait(PATIENCE)?, "the recorder does not get ready");
    Ok(recording)
}

#[test]
fn in_lock_step_the_plant_waits_for_the_record_and_nothing_is_lost() -> Result<(), Box<dyn Error>> {
    const TICKS: u64 = 300;
    let folder = TempDir::new()?;
    fs::create_dir(folder.path().join("settings"))?;
    fs::write(folder.path().join("settings/plant.toml"), "[robot]\n")?;
    let exchange = Exchange::new(true, PATIENCE);
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let mut credits = ports.source::<Credit>(Since::First)?;
    let recording = Recording::start(&exchange, settings(folder.path(), Pace::LockStep, false));
    let mut graph = Graph::open(&ports)?;
    let mut through_tick = None;
    for tick in 0..TICKS {
        while through_tick.is_none_or(|through_tick| through_tick < tick) {
            assert!(credits.wait(PATIENCE)?, "no credit for tick {tick}");
            through_tick = credits.latest()?.map(|credit| credit.through_tick).or(through_tick);
        }
        graph.tick(tick)?;
    }
    let summary = recording.stop()?;

    let stored = stored(&folder.path().join("record.mcap"))?;
    for topic in ["state", "truth", "command", "plan", "residual"] {
        assert_eq!((topic, stored.get(topic).copied()), (topic, Some(TICKS)));
    }
    assert_eq!(stored.get("snapshot").copied(), Some(TICKS / SNAPSHOT_TICKS));
    assert!(
        summary
            .losses
            .values()
            .all(|of_topic| of_topic.get("recorder").is_none_or(|lost| *lost == 0)),
        "{:?}",
        summary.losses
    );
    assert_eq!(summary.losses["state"]["controller"], 29);
    assert_eq!(summary.arrival_s, Some(2.0));
    assert_eq!(
        (
            summary.periods,
            summary.fallback_levels.on(FallbackLevel::FreshPlan),
            summary.periods_missed
        ),
        (TICKS - 1, TICKS - 1, 0)
    );
    assert_eq!(
        (
            summary.snapshots_adopted,
            summary.plant_epochs,
            summary.controller_epochs,
            summary.segments
        ),
        (12, 1, 1, 1)
    );

    let written: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("summary.json"))?)?;
    assert_eq!(written["periods"], TICKS - 1);
    let bytes = fs::read(folder.path().join("record.mcap"))?;
    let index = mcap::Summary::read(&bytes)?.ok_or("no index")?;
    let attached = index.attachment_indexes.first().ok_or("no attachment")?;
    assert_eq!(
        (attached.name.as_str(), &*mcap::read::attachment(&bytes, attached)?.data),
        ("plant.toml", b"[robot]\n".as_slice())
    );
    let metadata =
        mcap::read::metadata(&bytes, index.metadata_indexes.first().ok_or("no metadata")?)?;
    assert_eq!(metadata.metadata.get("period_nanos").map(String::as_str), Some("100000000"));
    Ok(())
}

#[test]
fn a_plant_that_sends_only_health_receives_its_credit_again() -> Result<(), Box<dyn Error>> {
    const TOLD_AGAIN: u64 = 2;
    let folder = TempDir::new()?;
    let exchange = Exchange::new(true, PATIENCE);
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let mut credits = ports.source::<Credit>(Since::First)?;
    let recording = Recording::start(&exchange, settings(folder.path(), Pace::LockStep, false));
    let (mut graph, mut healths) = (Graph::open(&ports)?, ports.sink::<Health>()?);
    for silent_from in [0, 20] {
        for tick in 0..silent_from {
            graph.tick(tick)?;
        }
        let (begin, told_before) = (Instant::now(), credits.tally().stale);
        while credits.tally().stale < told_before + TOLD_AGAIN {
            if begin.elapsed() > PATIENCE {
                return Err(
                    format!("before tick {silent_from} the credit is not sent again").into()
                );
            }
            healths.send(&mut Health {
                participant: Participant::Plant.code(),
                ..Zeroable::zeroed()
            })?;
            credits.wait(HEARTBEAT)?;
            while credits.next()?.is_some() {}
        }
    }
    recording.stop()?;
    Ok(())
}

#[test]
fn every_message_is_stored_or_counted_as_lost() -> Result<(), Box<dyn Error>> {
    const TICKS: u64 = 5000;
    let folder = TempDir::new()?;
    let exchange = Exchange::new(false, PATIENCE);
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let recording =
        wait_until_it_listens(&ports, &exchange, settings(folder.path(), Pace::RealTime, false))?;
    let mut graph = Graph::open(&ports)?;
    for tick in 0..TICKS {
        graph.tick(tick)?;
    }
    let summary = recording.stop()?;
    let stored = stored(&folder.path().join("record.mcap"))?;
    for topic in ["state", "truth", "command", "plan", "residual"] {
        assert_eq!((topic, stored[topic] + summary.losses[topic]["recorder"]), (topic, TICKS));
    }
    assert_eq!(stored["snapshot"] + summary.losses["snapshot"]["recorder"], TICKS / SNAPSHOT_TICKS);
    Ok(())
}

#[test]
fn a_restarted_recorder_continues_in_a_new_file_and_summarises_both() -> Result<(), Box<dyn Error>>
{
    let folder = TempDir::new()?;
    let (first, second) = (folder.path().join("record.mcap"), folder.path().join("record-2.mcap"));
    let exchange = Exchange::new(false, PATIENCE);
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let mut graph = Graph::open(&ports)?;
    let recording =
        wait_until_it_listens(&ports, &exchange, settings(folder.path(), Pace::RealTime, false))?;
    for tick in 0..40 {
        graph.tick(tick)?;
    }
    recording.stop()?;
    // The state after a kill -9: without index, and cut in the middle of a chunk.
    let mut cut = fs::read(&first)?;
    cut.truncate(cut.len() * 2 / 3);
    fs::write(&first, &cut)?;
    for tick in 40..50 {
        graph.tick(tick)?;
    }
    let recording =
        wait_until_it_listens(&ports, &exchange, settings(folder.path(), Pace::RealTime, true))?;
    for tick in 50..90 {
        graph.tick(tick)?;
    }
    let summary = recording.stop()?;

    assert_eq!(fs::read(&first)?, cut, "the first file is unchanged");
    assert_eq!(segment::paths(folder.path()), [first, second.clone()]);
    assert_eq!((summary.segments, summary.plant_epochs), (2, 1));
    // The last earlier state came once more.
    assert_eq!(stored(&second)?["state"], 41);
    let lost = summary.losses["state"]["recorder"];
    assert!((9..49).contains(&lost), "those of the outage, and those cut off: {lost}");
    assert!(summary.periods + lost >= 89, "a state is a period, or is lost");
    Ok(())
}

#[test]
fn a_record_is_never_overwritten() -> Result<(), Box<dyn Error>> {
    let folder = TempDir::new()?;
    let exchange = Exchange::new(false, PATIENCE);
    Recording::start(&exchange, settings(folder.path(), Pace::RealTime, false)).stop()?;
    let record = fs::read(folder.path().join("record.mcap"))?;
    let again = recorder::run::run(
        &Ports::in_memory(&exchange, Identity::new(2)),
        &settings(folder.path(), Pace::RealTime, false),
        &Stop::new(),
    );
    assert!(matches!(again, Err(RecorderError::Record(RecordError::Exists { .. }))), "{again:?}");
    assert_eq!(fs::read(folder.path().join("record.mcap"))?, record);
    Ok(())
}

#[test]
fn the_error_names_a_missing_folder() {
    let exchange = Exchange::new(false, PATIENCE);
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let outcome = recorder::run::run(
        &ports,
        &settings(Path::new("/nowhere/run"), Pace::RealTime, false),
        &Stop::new(),
    );
    let Err(RecorderError::Record(RecordError::Create { path, source })) = outcome else {
        return assert!(outcome.is_err(), "{outcome:?}");
    };
    assert_eq!(
        (path.as_path(), source.kind()),
        (Path::new("/nowhere/run/record.mcap"), io::ErrorKind::NotFound)
    );
}
