//! Messages → one MCAP file: chunks compressed with LZ4, a JSON Schema per topic, channels for
//! viewers, and the settings of the run as attachments.
//!
//! A run's first file is `record.mcap`. A recorder that restarts in the same run continues in
//! `record-2.mcap`, and so on. No file is ever overwritten. Data older than 0.2 s is with the
//! operating system and survives a kill -9.

use crate::changes;
use crate::visual::{Drawing, Shown};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use process::requests::Settled;
use process::{Pace, Run};
use protocol::clock;
use protocol::message::{
    Command, Goal, Health, ModelSnapshot, Obstacles, Plan, PlantState, ResidualSample, Truth,
};
use protocol::topic::{OnTopic, TOPIC_COUNT, Topic};
use protocol::view::{self, View};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Profile of a record's files.
pub const PROFILE: &str = "coxswain";

/// Longest time that a written message stays in this process \[ns\].
const FLUSH_NANOS: u64 = 200_000_000;

/// Largest number of segments of one run.
const SEGMENTS_MAX: usize = 10_000;

/// Why a record cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// Two runs in one folder could not be distinguished. Use another folder, or move the old
    /// record.
    #[error(
        "{} is the record of an earlier run and is not overwritten; \
         use another folder, or move it",
        path.display()
    )]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created.
    #[error("{} cannot be created", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A settings file cannot be attached.
    #[error("{} cannot be read", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A write failed, usually because the disk is full.
    #[error("{} cannot be written", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// One file of the record of a run, open for writing.
pub struct Segment {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    /// Channel by topic; `None` for a topic that is not recorded.
    channels: [Option<u16>; TOPIC_COUNT],
    /// Channel and number of messages of each drawing, in the order of [`Shown::ALL`].
    drawings: [(u16, u32); Shown::ALL.len()],
    /// Channel of the changes of settings.
    changes: u16,
    json: Vec<u8>,
    flushed_nanos: u64,
    /// The same file, to truncate it to its last complete state.
    file: File,
    /// Length of that state \[bytes\].
    whole_bytes: u64,
    /// Number of messages since then, by topic.
    since: [u64; TOPIC_COUNT],
}

impl Segment {
    /// Creates the next file of the run's record, with schemas and settings.
    ///
    /// # Errors
    /// [`RecordError`]; [`RecordError::Exists`] if the folder holds a record and the recorder is
    /// not a restarted one.
    pub fn create(run: &Run) -> Result<Self, RecordError> {
        let (number, path, file) = next_file(&run.folder, run.restarted)?;
        let attachments = settings_files(&run.folder)?;
        let mut segment = Self::over(path.clone(), file)
            .map_err(|error| RecordError::Write { path, source: cause(error) })?;
        let described = segment.describe(&metadata(run, number), &attachments);
        described.map_err(|error| segment.failed(error))?;
        segment.flush()?;
        Ok(segment)
    }

    /// Begins an MCAP file in `file`.
    fn over(path: PathBuf, file: File) -> Result<Self, McapError> {
        let kept = file.try_clone().map_err(McapError::Io)?;
        // Without seeking, a chunk is built in memory and written at once: a killed recorder leaves
        // complete chunks.
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .profile(PROFILE)
            .disable_seeking(true)
            .create(BufWriter::new(file))?;
        let mut channels = [None; TOPIC_COUNT];
        add_channel::<PlantState>(&mut writer, &mut channels)?;
        add_channel::<Command>(&mut writer, &mut channels)?;
        add_channel::<ResidualSample>(&mut writer, &mut channels)?;
        add_channel::<ModelSnapshot>(&mut writer, &mut channels)?;
        add_channel::<Plan>(&mut writer, &mut channels)?;
        add_channel::<Health>(&mut writer, &mut channels)?;
        add_channel::<Truth>(&mut writer, &mut channels)?;
        add_channel::<Goal>(&mut writer, &mut channels)?;
        add_channel::<Obstacles>(&mut writer, &mut channels)?;
        let mut drawings = [(0, 0); Shown::ALL.len()];
        for (shown, (channel, _)) in Shown::ALL.into_iter().zip(&mut drawings) {
            let schema = writer.add_schema(
                shown.kind(),
                "jsonschema",
                shown.schema().to_string().as_bytes(),
            )?;
            *channel = writer.add_channel(schema, shown.channel(), "json", &BTreeMap::new())?;
        }
        let schema = writer.add_schema(
            changes::KIND,
            "jsonschema",
            changes::schema().to_string().as_bytes(),
        )?;
        let changes = writer.add_channel(schema, changes::CHANNEL, "json", &BTreeMap::new())?;
        let (json, flushed_nanos) = (Vec::new(), clock::monotonic_nanos());
        Ok(Self {
            path,
            writer,
            channels,
            drawings,
            changes,
            json,
            flushed_nanos,
            file: kept,
            whole_bytes: 0,
            since: [0; TOPIC_COUNT],
        })
    }

    /// Appends `message`, with the time at which it was sent.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub fn write<T: OnTopic>(&mut self, message: &T) -> Result<(), RecordError> {
        self.append(message).map_err(|error| self.failed(error))?;
        if let Some(count) = self.since.get_mut(T::TOPIC.index()) {
            *count += 1;
        }
        Ok(())
    }

    /// Appends a drawing, with the time of its source.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub(crate) fn draw(
        &mut self,
        shown: Shown,
        drawing: &Drawing,
        log_time: u64,
    ) -> Result<(), RecordError> {
        let Some((channel_id, count)) = self.drawings.get_mut(shown as usize) else {
            return Ok(());
        };
        *count += 1;
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *count,
            log_time,
            publish_time: log_time,
        };
        self.append_json(&header, drawing).map_err(|error| self.failed(error))
    }

    /// Appends a change of settings, accepted or rejected, with the time of the reply.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub(crate) fn write_change(&mut self, settled: &Settled) -> Result<(), RecordError> {
        let (log_time, sequence) = (settled.answer.answered_nanos, settled.number as u32);
        let header =
            MessageHeader { channel_id: self.changes, sequence, log_time, publish_time: log_time };
        self.append_json(&header, settled).map_err(|error| self.failed(error))
    }

    /// Passes data that has waited for 0.2 s to the operating system.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub fn flush_if_due(&mut self) -> Result<(), RecordError> {
        let now = clock::monotonic_nanos();
        if now.saturating_sub(self.flushed_nanos) >= FLUSH_NANOS {
            self.flushed_nanos = now;
            self.flush()?;
        }
        Ok(())
    }

    /// Closes the file with its index, and syncs it to the disk.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub fn finish(mut self) -> Result<(), RecordError> {
        let finished = self.writer.finish().map(drop);
        finished.map_err(|error| self.failed(error))?;
        let path = self.path;
        let file = self.writer.into_inner().into_inner().map_err(io::IntoInnerError::into_error);
        file.and_then(|file| file.sync_all()).map_err(|source| RecordError::Write { path, source })
    }

    fn describe(
        &mut self,
        metadata: &Metadata,
        attachments: &[Attachment],
    ) -> Result<(), McapError> {
        self.writer.write_metadata(metadata)?;
        attachments.iter().try_for_each(|attachment| self.writer.attach(attachment))
    }

    /// Passes all data to the operating system.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.writer.flush().map_err(|error| self.failed(error))?;
        let length = self.file.metadata().map_err(|error| self.failed(McapError::Io(error)))?.len();
        (self.whole_bytes, self.since) = (length, [0; TOPIC_COUNT]);
        Ok(())
    }

    /// Gives up a file that cannot be written: truncates it to its last complete state. Returns the
    /// number of messages of each topic that are not in it.
    pub fn abandon(self) -> [u64; TOPIC_COUNT] {
        let Self { writer, file, whole_bytes, since, path, .. } = self;
        // Dropping it tries to write the remaining data.
        drop(writer);
        if let Err(error) = file.set_len(whole_bytes) {
            tracing::warn!(%error, path = %path.display(), "the end of the file is incomplete");
        }
        since
    }

    fn append<T: OnTopic>(&mut self, message: &T) -> Result<(), McapError> {
        let stamp = message.stamp();
        let channel = self.channels.get(T::TOPIC.index()).copied().flatten();
        let channel_id = channel.ok_or(McapError::UnknownChannel(stamp.sequence as u32, 0))?;
        let (log_time, sequence) = (stamp.sent_nanos, stamp.sequence as u32);
        self.append_json(
            &MessageHeader { channel_id, sequence, log_time, publish_time: log_time },
            &View(message),
        )
    }

    fn append_json(
        &mut self,
        header: &MessageHeader,
        content: &impl Serialize,
    ) -> Result<(), McapError> {
        self.json.clear();
        serde_json::to_writer(&mut self.json, content).map_err(io::Error::from)?;
        self.writer.write_to_known_channel(header, &self.json)
    }

    fn failed(&self, error: McapError) -> RecordError {
        RecordError::Write { path: self.path.clone(), source: cause(error) }
    }
}

/// The error of the operating system, if it is the cause.
fn cause(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// The files of the record in `folder`, in the order in which they were written.
pub fn paths(folder: &Path) -> Vec<PathBuf> {
    (1..=SEGMENTS_MAX)
        .map(|number| path_of(folder, number))
        .take_while(|path| path.exists())
        .collect()
}

fn path_of(folder: &Path, number: usize) -> PathBuf {
    folder.join(if number == 1 {
        "record.mcap".to_owned()
    } else {
        format!("record-{number}.mcap")
    })
}

fn next_file(folder: &Path, restarted: bool) -> Result<(usize, PathBuf, File), RecordError> {
    let number = paths(folder).len() + 1;
    if number > 1 && !restarted {
        return Err(RecordError::Exists { path: path_of(folder, 1) });
    }
    let path = path_of(folder, number);
    match OpenOptions::new().write(true).create_new(true).open(&path) {
        Ok(file) => Ok((number, path, file)),
        Err(source) => Err(RecordError::Create { path, source }),
    }
}

fn add_channel<T: OnTopic>(
    writer: &mut Writer<BufWriter<File>>,
    channels: &mut [Option<u16>; TOPIC_COUNT],
) -> Result<(), McapError> {
    let topic: Topic = T::TOPIC;
    let schema = view::schema::<T>().to_string();
    let schema =
        writer.add_schema(&format!("coxswain.{}", T::NAME), "jsonschema", schema.as_bytes())?;
    let channel = writer.add_channel(schema, topic.name(), "json", &BTreeMap::new())?;
    if let Some(slot) = channels.get_mut(topic.index()) {
        *slot = Some(channel);
    }
    Ok(())
}

/// Metadata of the run, and of the clock of its stamps.
fn metadata(run: &Run, number: usize) -> Metadata {
    let unix_nanos =
        SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
    let pace = match run.pace {
        Pace::RealTime => "real-time",
        Pace::LockStep => "lock-step",
    };
    let entries = [
        ("program", format!("coxswain recorder {}", env!("CARGO_PKG_VERSION"))),
        ("graph", run.links.graph.clone()),
        ("segment", number.to_string()),
        ("period_nanos", run.period_nanos.to_string()),
        ("pace", pace.to_owned()),
        ("clock", "monotonic".to_owned()),
        ("opened_monotonic_nanos", clock::monotonic_nanos().to_string()),
        ("opened_unix_nanos", unix_nanos.to_string()),
    ];
    Metadata {
        name: "coxswain".to_owned(),
        metadata: entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    }
}

/// The settings of the run's start, `settings/*.toml` in its folder.
fn settings_files(folder: &Path) -> Result<Vec<Attachment<'static>>, RecordError> {
    let folder = folder.join("settings");
    let failed = |path: &Path, source| RecordError::Settings { path: path.to_owned(), source };
    let entries = match fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(failed(&folder, error)),
    };
    let mut paths = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<io::Result<Vec<_>>>()
        .map_err(|error| failed(&folder, error))?;
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    let now = clock::monotonic_nanos();
    let attach = |path: PathBuf| {
        let data = Cow::Owned(fs::read(&path).map_err(|error| failed(&path, error))?);
        let name =
            path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        Ok(Attachment {
            log_time: now,
            create_time: now,
            name,
            media_type: "application/toml".to_owned(),
            data,
        })
    };
    paths.into_iter().map(attach).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, memfd_create};

    /// A segment on a disk that has become full since its creation.
    pub(crate) fn without_room() -> Result<Segment, Box<dyn std::error::Error>> {
        let disk = File::from(memfd_create("record", MemfdFlags::ALLOW_SEALING)?);
        let mut segment = Segment::over(PathBuf::from("full/record.mcap"), disk.try_clone()?)?;
        segment.flush()?;
        fcntl_add_seals(&disk, SealFlags::GROW)?;
        Ok(segment)
    }

    #[test]
    fn a_disk_that_fills_up_is_an_error_and_no_panic() -> Result<(), Box<dyn std::error::Error>> {
        let mut segment = without_room()?;
        let state: PlantState = Zeroable::zeroed();
        let outcome = segment.write(&state).and_then(|()| segment.flush());
        assert!(matches!(outcome, Err(RecordError::Write { .. })), "{outcome:?}");
        assert!(segment.write(&state).is_err(), "nor afterwards");
        assert!(segment.finish().is_err());
        Ok(())
    }
}
