//! Changes of settings during the run ▶ the record, as channel `set`.
//!
//! Every file of a record begins with all earlier replies of its run, so that each file is
//! complete. A request is identified by its process and number.

use crate::segment::RecordError;
use crate::store::Store;
use process::requests::Answers;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Name of the channel.
pub(crate) const CHANNEL: &str = "set";
/// Name of its type.
pub(crate) const KIND: &str = "coxswain.Set";

/// JSON Schema of its type.
pub(crate) fn schema() -> Value {
    let text = |about: &str| json!({"type": "string", "description": about});
    let count = |about: &str| json!({"type": "integer", "minimum": 0, "description": about});
    json!({
        "title": KIND,
        "type": "object",
        "properties": {
            "process": text("process that received the request"),
            "number": count("number of the change, per process"),
            "who": text("name of the user"),
            "user": count("user id of the user"),
            "asked_unix_nanos": count("time of the request since 1970 [ns]"),
            "answered_nanos": count("time of the reply on the monotonic clock [ns]"),
            "change": text("keys with their new values, as lines of TOML"),
            "outcome": text("applied or refused"),
            "code": text("kind of the rejection, for programs"),
            "reason": text("why it was rejected"),
            "plant_epoch": count("epoch of the plant whose ticks these are"),
            "taken_at_tick": count("tick at which the process read it"),
            "ready_at_tick": count("tick at which everything for it was checked and built"),
            "acts_from_tick": count("first tick with the whole change in use"),
        },
    })
}

/// Reads new replies and writes them to the store.
#[derive(Debug)]
pub(crate) struct Changes {
    folder: PathBuf,
    answers: Answers,
    /// Number of the record's file that they go to.
    file: u64,
}

impl Changes {
    pub(crate) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), answers: Answers::all(folder), file: 1 }
    }

    /// Writes new replies, if a check is due.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn write_new(&mut self, store: &mut Store) -> Result<(), RecordError> {
        if self.file != store.files() {
            (self.file, self.answers) = (store.files(), Answers::all(&self.folder));
        }
        // A reply that does not get into this file comes with the next.
        self.answers.look().iter().try_for_each(|settled| store.write_change(settled))
    }

    /// Writes the last replies.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn write_last(&mut self, store: &mut Store) -> Result<(), RecordError> {
        self.answers.look_now().iter().try_for_each(|settled| store.write_change(settled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use process::requests::{Answer, Outcome, Request, Settled};

    #[test]
    fn every_field_of_a_change_is_in_the_schema() -> Result<(), Box<dyn std::error::Error>> {
        let request = Request { who: "ada".into(), asked_unix_nanos: 1, change: "a = 1".into() };
        let applied = Outcome::Applied {
            plant_epoch: 1,
            taken_at_tick: 2,
            ready_at_tick: 2,
            acts_from_tick: 3,
        };
        for outcome in [applied, Outcome::refused("value", &"no")] {
            let answer = Answer { user: 0, answered_nanos: 5, outcome };
            let settled = Settled {
                process: "controller".into(),
                number: 1,
                request: request.clone(),
                answer,
            };
            let row = serde_json::to_value(&settled)?;
            let schema = schema();
            let known = schema["properties"].as_object().ok_or("no properties")?;
            assert!(
                row.as_object().ok_or("no object")?.keys().all(|key| known.contains_key(key)),
                "{row}"
            );
            assert_eq!(serde_json::from_value::<Settled>(row)?, settled);
        }
        Ok(())
    }
}
