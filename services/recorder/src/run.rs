//! All topics → one MCAP file → `summary.json`.

use crate::changes::Changes;
use crate::grant::Grant;
use crate::intake::Intake;
use crate::rows::{ReadError, Rows};
use crate::segment::{self, RecordError, Segment};
use crate::settings::Settings;
use crate::store::Store;
use crate::summary::{Summary, SummaryError};
use process::{Pace, Pulse, Stop};
use protocol::message::{Participant, Phase};
use std::error::Error;
use std::iter::successors;
use std::time::{Duration, Instant};
use transport::{OpenError, Ports, ReceiveError, Since};

/// Longest sleep, and so the interval of the topics other than the state.
const PATIENCE: Duration = Duration::from_millis(20);

/// Silence of all topics after which the record is closed.
const SILENCE: Duration = Duration::from_millis(100);

/// Longest time from the stop request to the end of the record, even if other processes still
/// publish.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// Why a run cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// A port cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A topic cannot be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The file cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The file cannot be read back.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The summary cannot be written.
    #[error(transparent)]
    Summary(#[from] SummaryError),
}

/// Records until `stop` is requested and all topics are silent, then summarises the whole run.
///
/// # Errors
/// [`RecorderError`]; the last Health reports it too. Data that was already written stays.
pub fn run(ports: &Ports, settings: &Settings, stop: &Stop) -> Result<Summary, RecorderError> {
    let mut pulse = Pulse::new(ports, Participant::Recorder)?.exposed(settings.run.exposure);
    let outcome = Segment::create(&settings.run).map_err(RecorderError::from).and_then(|segment| {
        Recorder::open(ports, settings, segment, &mut pulse)?.record(settings, stop)
    });
    tell(&mut pulse, settings.run.pace, outcome)
}

/// Reports how the recording ended.
fn tell(
    pulse: &mut Pulse,
    pace: Pace,
    outcome: Result<Summary, RecorderError>,
) -> Result<Summary, RecorderError> {
    match &outcome {
        Ok(_) => pulse.last_words(Phase::Finished, pace),
        Err(error) => {
            pulse.health().set_last_error(&cause_first(error));
            pulse.last_words(Phase::Degraded, pace);
        }
    }
    outcome
}

/// The whole error in one line, beginning with its cause, because Health cuts long lines.
fn cause_first(error: &(dyn Error + 'static)) -> String {
    let mut parts: Vec<String> =
        successors(Some(error), |&error| error.source()).map(ToString::to_string).collect();
    parts.reverse();
    parts.join(": ")
}

/// Result of one pass over all topics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Round {
    /// No message was waiting.
    Idle,
    /// At least one message was written.
    Wrote,
}

struct Recorder<'a> {
    intake: Intake,
    grant: Grant,
    store: Store,
    changes: Changes,
    pulse: &'a mut Pulse,
}

impl<'a> Recorder<'a> {
    fn open(
        ports: &Ports,
        settings: &Settings,
        segment: Segment,
        pulse: &'a mut Pulse,
    ) -> Result<Self, RecorderError> {
        let since = if settings.run.restarted { Since::Joining } else { Since::First };
        Ok(Self {
            intake: Intake::open(ports, since, settings.run.period_nanos)?,
            grant: Grant::open(ports, settings.run.pace)?,
            store: Store::new(segment, &settings.run),
            changes: Changes::new(&settings.run.folder),
            pulse,
        })
    }

    /// Writes until the end, then closes the file and summarises all files of the run.
    fn record(mut self, settings: &Settings, stop: &Stop) -> Result<Summary, RecorderError> {
        self.pulse.phase(Phase::Ready);
        self.write_until(stop)?;
        self.receive_rest()?;
        let unwritten = self.store.finish()?;
        let folder = &settings.run.folder;
        let summary = Summary::of(&Rows::read(&segment::paths(folder))?, settings.run.period_nanos)
            .without(unwritten);
        summary.write(folder)?;
        Ok(summary)
    }

    fn write_until(&mut self, stop: &Stop) -> Result<(), RecorderError> {
        while !stop.requested() {
            self.grant();
            let woken = self.intake.states.wait(PATIENCE)?;
            self.round()?;
            if let Some(why) = self.store.closed() {
                self.pulse.health().set_last_error(why);
                self.pulse.phase(Phase::Degraded);
            } else if woken {
                self.pulse.phase(Phase::Running);
            } else if let Err(error) = self.grant.refresh() {
                tracing::warn!(%error, "processes that joined late have no credit");
            }
            self.count();
            self.grant.count(self.pulse);
            self.pulse.beat();
        }
        Ok(())
    }

    /// Writes the last messages of the other processes, which were stopped earlier.
    fn receive_rest(&mut self) -> Result<(), RecorderError> {
        let requested = Instant::now();
        let mut received = requested;
        while received.elapsed() < SILENCE && requested.elapsed() < LAST_WORDS {
            self.intake.states.wait(PATIENCE)?;
            if self.round()? == Round::Wrote {
                received = Instant::now();
            }
        }
        self.changes.write_last(&mut self.store)?;
        self.count();
        // The losses up to the end belong into the record, and no topic is read any more.
        self.pulse.send_now();
        self.store.write(self.pulse.health())?;
        Ok(())
    }

    /// Writes the waiting messages, per topic at most as many as its queue holds.
    fn round(&mut self) -> Result<Round, RecorderError> {
        let written = self.intake.drain(&mut self.store, &mut self.grant)?;
        self.store.tend()?;
        self.changes.write_new(&mut self.store)?;
        Ok(if written == 0 { Round::Idle } else { Round::Wrote })
    }

    /// Counts the messages that were lost on a link or could not be written.
    fn count(&mut self) {
        self.intake.count(self.pulse);
        for (lost, unwritten) in self.pulse.health().lost.iter_mut().zip(self.store.unwritten()) {
            *lost += unwritten;
        }
    }

    /// Grants credit. If the plant does not accept it, the launcher detects that; the record
    /// continues.
    fn grant(&mut self) {
        if let Err(error) = self.grant.extend() {
            tracing::warn!(%error, "the credit could not be sent to the plant");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use process::Run;
    use protocol::message::{Health, PlantState};
    use protocol::topic::Topic;
    use transport::{Exchange, Identity, Links};

    fn settings(folder: &std::path::Path, pace: Pace) -> Settings {
        let links = Links::on_this_machine("test", folder.to_owned(), false, 1000);
        Settings { run: Run { epoch_floor: 1, pace, ..Run::new(folder, 100_000_000, links) } }
    }

    #[test]
    fn in_lock_step_a_full_disk_is_reported_before_the_end() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let settings = settings(folder.path(), Pace::LockStep);
        let ports =
            Ports::in_memory(&Exchange::new(false, Duration::from_secs(1)), Identity::new(1));
        let mut healths = ports.source::<Health>(Since::First)?;
        let segment = segment::tests::without_room()?;
        let mut pulse = Pulse::new(&ports, Participant::Recorder)?;
        let outcome =
            Recorder::open(&ports, &settings, segment, &mut pulse)?.record(&settings, &Stop::new());
        let outcome = tell(&mut pulse, Pace::LockStep, outcome);
        assert!(
            matches!(outcome, Err(RecorderError::Record(RecordError::Write { .. }))),
            "{outcome:?}"
        );
        let last = healths.latest()?.ok_or("no health")?;
        assert!(last.last_error().contains("full/record.mcap"), "{}", last.last_error());
        assert_eq!(last.phase(), Phase::Degraded);
        Ok(())
    }

    #[test]
    fn in_real_time_messages_without_room_on_the_disk_are_counted_until_there_is_room_again()
    -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let settings = settings(folder.path(), Pace::RealTime);
        let ports =
            Ports::in_memory(&Exchange::new(false, Duration::from_secs(1)), Identity::new(1));
        let mut healths = ports.source::<Health>(Since::First)?;
        let mut states = ports.sink::<PlantState>()?;
        let mut pulse = Pulse::new(&ports, Participant::Recorder)?;
        let mut recorder =
            Recorder::open(&ports, &settings, segment::tests::without_room()?, &mut pulse)?;
        recorder.pulse.phase(Phase::Ready);
        let stop = Stop::new();
        let mut state: PlantState = bytemuck::Zeroable::zeroed();
        for _ in 0..7 {
            states.send(&mut state)?;
        }
        recorder.round()?;
        std::thread::sleep(Duration::from_millis(250)); // a flush is due
        recorder.round()?;
        assert!(
            recorder.store.closed().is_some_and(|why| why.contains("full/record.mcap")),
            "{:?}",
            recorder.store.closed()
        );
        std::thread::sleep(Duration::from_millis(1100));
        recorder.round()?; // there is room again, in another file
        for _ in 0..5 {
            states.send(&mut state)?;
        }
        recorder.round()?;
        stop.request();
        let summary = recorder.record(&settings, &stop)?;
        assert_eq!(summary.unwritten.get("state"), Some(&7), "{:?}", summary.unwritten);
        assert_eq!(healths.latest()?.ok_or("no health")?.lost[Topic::State.index()], 7);
        let rows = Rows::read(&segment::paths(folder.path()))?;
        assert_eq!(rows.states.len(), 5);
        Ok(())
    }
}
