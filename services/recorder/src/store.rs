//! Destination of the record: a file, or none while the disk is full; then the messages are
//! counted.

use crate::segment::{RecordError, Segment};
use crate::visual::{Drawing, Shown};
use process::requests::Settled;
use process::{Pace, Run};
use protocol::topic::{OnTopic, TOPIC_COUNT};
use std::error::Error;
use std::fs;
use std::time::{Duration, Instant};

/// Time after which another file is tried on a full disk.
const RETRY: Duration = Duration::from_secs(1);

/// The record of a run, file after file.
pub(crate) struct Store {
    run: Run,
    segment: Option<Segment>,
    /// Number of files so far.
    files: u64,
    /// Why there is no file.
    closed: String,
    retry_at: Instant,
    /// Messages that are in no file, by topic.
    unwritten: [u64; TOPIC_COUNT],
}

impl Store {
    pub(crate) fn new(segment: Segment, run: &Run) -> Self {
        let closed = String::new();
        Self {
            run: run.clone(),
            segment: Some(segment),
            files: 1,
            closed,
            retry_at: Instant::now(),
            unwritten: [0; TOPIC_COUNT],
        }
    }

    /// Appends `message`, or counts it.
    ///
    /// # Errors
    /// [`RecordError`] in lock step, which must lose no message.
    pub(crate) fn write<T: OnTopic>(&mut self, message: &T) -> Result<(), RecordError> {
        let written = self.segment.as_mut().map(|segment| segment.write(message));
        if !matches!(written, Some(Ok(())))
            && let Some(count) = self.unwritten.get_mut(T::TOPIC.index())
        {
            *count += 1;
        }
        written.map_or(Ok(()), |written| self.survive(written))
    }

    /// Appends a drawing at `log_time` \[ns\], if there is a file.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn draw(
        &mut self,
        drawn: &[(Shown, Drawing)],
        log_time: u64,
    ) -> Result<(), RecordError> {
        for (shown, drawing) in drawn {
            let written = self
                .segment
                .as_mut()
                .map_or(Ok(()), |segment| segment.draw(*shown, drawing, log_time));
            self.survive(written)?;
        }
        Ok(())
    }

    /// Appends a change of settings, if there is a file.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn write_change(&mut self, settled: &Settled) -> Result<(), RecordError> {
        let written = self.segment.as_mut().map_or(Ok(()), |segment| segment.write_change(settled));
        self.survive(written)
    }

    /// Number of files so far, the present one included.
    pub(crate) fn files(&self) -> u64 {
        self.files
    }

    /// Passes waiting data to the operating system, or checks whether there is room again.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn tend(&mut self) -> Result<(), RecordError> {
        if let Some(segment) = &mut self.segment {
            let flushed = segment.flush_if_due();
            return self.survive(flushed);
        }
        if Instant::now() >= self.retry_at {
            self.retry_at = Instant::now() + RETRY;
            match Segment::create(&Run { restarted: true, ..self.run.clone() }) {
                Ok(segment) => {
                    tracing::warn!(
                        unwritten = ?self.unwritten,
                        "there is room again: the record continues in another file"
                    );
                    self.segment = Some(segment);
                    self.files += 1;
                }
                // The file that was just begun has no messages.
                Err(RecordError::Write { path, .. }) => drop(fs::remove_file(path)),
                Err(_) => {}
            }
        }
        Ok(())
    }

    /// Why nothing is written at present.
    pub(crate) fn closed(&self) -> Option<&str> {
        self.segment.is_none().then_some(self.closed.as_str())
    }

    /// Messages that are in no file, by topic.
    pub(crate) fn unwritten(&self) -> [u64; TOPIC_COUNT] {
        self.unwritten
    }

    /// Closes the last file. Returns the messages that are in no file.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn finish(mut self) -> Result<[u64; TOPIC_COUNT], RecordError> {
        if let Some(segment) = &mut self.segment {
            let flushed = segment.flush();
            self.survive(flushed)?;
        }
        if let Some(segment) = self.segment.take() {
            segment.finish()?;
        }
        Ok(self.unwritten)
    }

    /// In real time, gives up a file that cannot be written.
    fn survive(&mut self, written: Result<(), RecordError>) -> Result<(), RecordError> {
        let Err(error) = written else { return Ok(()) };
        if self.run.pace == Pace::LockStep {
            return Err(error);
        }
        self.closed =
            error.source().map_or_else(|| error.to_string(), |cause| format!("{cause}: {error}"));
        tracing::error!("{}; messages are only counted until there is room again", self.closed);
        if let Some(segment) = self.segment.take() {
            for (unwritten, lost) in self.unwritten.iter_mut().zip(segment.abandon()) {
                *unwritten += lost;
            }
        }
        self.retry_at = Instant::now() + RETRY;
        Ok(())
    }
}
