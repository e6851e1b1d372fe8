//! The messages of one run, as they were recorded.

use protocol::topic::Topic;
use recorder::reader;
use serde_json::Value;
use std::path::Path;
use std::{fs, io};

/// One recorded message.
#[derive(Debug, Clone)]
pub struct Message {
    /// Name of the topic.
    pub topic: String,
    /// Content, as JSON.
    pub fields: Value,
}

impl Message {
    /// A number of its stamp.
    pub fn stamp(&self, field: &str) -> u64 {
        self.fields["stamp"][field].as_u64().unwrap_or(u64::MAX)
    }

    /// A whole number.
    pub fn count(&self, field: &str) -> u64 {
        self.fields[field].as_u64().unwrap_or(u64::MAX)
    }

    /// A word.
    pub fn word(&self, field: &str) -> &str {
        self.fields[field].as_str().unwrap_or("?")
    }

    /// A list of numbers.
    pub fn numbers(&self, field: &str) -> Vec<f64> {
        self.fields[field].as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
    }
}

/// All messages of a run, segment after segment, in the order of recording.
#[derive(Debug)]
pub struct Record {
    messages: Vec<Message>,
    /// `summary.json`; null if there is none, as after a kill of all processes.
    pub summary: Value,
}

impl Record {
    /// Reads the record in a run directory. Truncated segments are read as far as possible.
    ///
    /// # Errors
    /// If there is no record, or the file is no record.
    pub fn read(folder: &Path) -> io::Result<Self> {
        Self::read_as(folder, |_, _| true)
    }

    /// Reads it without predictions, data points and drawings, but with the tails of commands and
    /// the obstacles. Long runs fit into memory then.
    ///
    /// # Errors
    /// If there is no record, or the file is no record.
    pub fn read_without_rows(folder: &Path) -> io::Result<Self> {
        Self::read_as(folder, |topic, fields| {
            let fields = fields.as_object_mut().into_iter();
            let kept = |name: &str, value: &Value| {
                matches!(name, "tail" | "obstacles")
                    || !value.as_array().is_some_and(|rows| rows.iter().any(Value::is_array))
            };
            fields.for_each(|fields| fields.retain(|name, value| kept(name, value)));
            Topic::ALL.iter().any(|known| known.name() == topic)
        })
    }

    /// Reads the messages that `keep` accepts, after `keep` has changed them.
    fn read_as(folder: &Path, keep: impl Fn(&str, &mut Value) -> bool) -> io::Result<Self> {
        let mut segments: Vec<_> =
            fs::read_dir(folder)?.flatten().map(|entry| entry.path()).collect();
        segments.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
        segments.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
        let mut messages = Vec::new();
        for segment in segments {
            reader::messages(&segment, |message| {
                let (topic, mut fields) =
                    (message.channel.topic.clone(), serde_json::from_slice(&message.data)?);
                if keep(&topic, &mut fields) {
                    messages.push(Message { topic, fields });
                }
                Ok(())
            })?;
        }
        let summary = match fs::read_to_string(folder.join("summary.json")) {
            Ok(text) => serde_json::from_str(&text)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Value::Null,
            Err(error) => return Err(error),
        };
        Ok(Self { messages, summary })
    }

    /// A record of these messages, without a summary.
    pub fn of_messages(messages: Vec<Message>) -> Self {
        Self { messages, summary: Value::Null }
    }

    /// All messages.
    pub fn messages(&self) -> &[Message] {
        &self.messages
    }

    /// The messages of one topic.
    pub fn of<'a>(&'a self, topic: &'a str) -> impl DoubleEndedIterator<Item = &'a Message> {
        self.messages.iter().filter(move |message| message.topic == topic)
    }

    /// The Health messages of one participant.
    pub fn health_of<'a>(
        &'a self,
        participant: &'a str,
    ) -> impl DoubleEndedIterator<Item = &'a Message> {
        self.of("health").filter(move |message| message.word("participant") == participant)
    }
}
