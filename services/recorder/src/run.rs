//! every topic → one MCAP file → `summary.json`.

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
use protocol::port::{OpenError, Ports, ReceiveError, Since};
use std::error::Error;
use std::iter::successors;
use std::time::{Duration, Instant};

/// Longest sleep: topics other than the state are looked at as often.
const PATIENCE: Duration = Duration::from_millis(20);

/// Everything must have been silent for so long before the record is closed.
const SILENCE: Duration = Duration::from_millis(100);

/// The record is closed this long after the request to stop even if the others go on talking.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// A run cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// No place in the graph.
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

/// Records until `stop` is requested and nobody says anything any more, then sums up the whole run.
///
/// # Errors
/// [`RecorderError`]; the last Health says it too. What was written before stays.
pub fn run(ports: &Ports, settings: &Settings, stop: &Stop) -> Result<Summary, RecorderError> {
    let mut pulse = Pulse::new(ports, Participant::Recorder)?.exposed(settings.run.exposure);
    let outcome = Segment::create(&settings.run).map_err(RecorderError::from).and_then(|segment| {
        Recorder::open(ports, settings, segment, &mut pulse)?.record(settings, stop)
    });
    tell(&mut pulse, settings.run.pace, outcome)
}

/// Tells the others how it ended.
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

/// The whole error in one line, its cause in front, since Health cuts long lines.
fn cause_first(error: &(dyn Error + 'static)) -> String {
    let mut parts: Vec<String> =
        successors(Some(error), |&error| error.source()).map(ToString::to_string).collect();
    parts.reverse();
    parts.join(": ")
}

/// What one round through all topics came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Round {
    /// Nothing waited.
    Idle,
    /// Something was written.
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

    /// Writes until the end, then ends the file and sums up all files of the run.
    fn record(mut self, settings: &Settings, stop: &Stop) -> Result<Summary, RecorderError> {
        self.pulse.phase(Phase::Ready);
        self.write_until(stop)?;
        self.hear_out()?;
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
                tracing::warn!(%error, "late joiners have no credit");
            }
            self.count();
            self.grant.count(self.pulse);
            self.pulse.beat();
        }
        Ok(())
    }

    /// Writes the last words of the others, who were asked to stop before.
    fn hear_out(&mut self) -> Result<(), RecorderError> {
        let requested = Instant::now();
        let mut heard = requested;
        while heard.elapsed() < SILENCE && requested.elapsed() < LAST_WORDS {
            self.intake.states.wait(PATIENCE)?;
            if self.round()? == Round::Wrote {
                heard = Instant::now();
            }
        }
        self.changes.write_last(&mut self.store)?;
        self.count();
        // What was lost until the very end belongs into the record, and nothing is read any more.
        self.pulse.send_now();
        self.store.write(self.pulse.health())?;
        Ok(())
    }

    /// Writes what waits, at most as many messages per topic as can wait at a time.
    fn round(&mut self) -> Result<Round, RecorderError> {
        let written = self.intake.drain(&mut self.store, &mut self.grant)?;
        self.store.tend()?;
        self.changes.write_new(&mut self.store)?;
        Ok(if written == 0 { Round::Idle } else { Round::Wrote })
    }

    /// What did not come, and what came and could not be written, is lost to the record.
    fn count(&mut self) {
        self.intake.count(self.pulse);
        for (lost, unwritten) in self.pulse.health().lost.iter_mut().zip(self.store.unwritten()) {
            *lost += unwritten;
        }
    }

    /// A plant that does not take its credit in is for the launcher to find; the record goes on.
    fn grant(&mut self) {
        if let Err(error) = self.grant.extend() {
            tracing::warn!(%error, "the plant has not got its credit");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use process::Run;
    use protocol::message::{Health, PlantState};
    use protocol::port::{Exchange, Identity, Links};
    use protocol::topic::Topic;

    fn settings(folder: &std::path::Path, pace: Pace) -> Settings {
        let links = Links::on_this_machine("test", folder.to_owned(), false, 1000);
        Settings { run: Run { epoch_floor: 1, pace, ..Run::new(folder, 100_000_000, links) } }
    }

    #[test]
    fn in_lock_step_a_full_disk_is_told_to_the_others_before_the_end() -> Result<(), Box<dyn Error>>
    {
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
        assert!(
            last.last_error().ends_with(": full/record.mcap cannot be written"),
            "{}",
            last.last_error()
        );
        assert_eq!(last.phase(), Phase::Degraded);
        Ok(())
    }

    #[test]
    fn in_real_time_what_has_no_room_on_the_disk_is_counted_and_the_rest_is_recorded_once_there_is_room_again()
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
            recorder
                .store
                .closed()
                .is_some_and(|why| why.contains("full/record.mcap cannot be written")),
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
