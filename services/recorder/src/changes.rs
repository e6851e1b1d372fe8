//! What a person has changed while the robot drove ▶ the record, as channel `set`.
//!
//! Every file of a record begins with all that has been answered before in its run, so that none needs the others to be understood: a
//! request is known by its process and number.

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
            "process": text("who was asked"),
            "number": count("of the change, for each process apart"),
            "who": text("name of the person"),
            "user": count("user id of the person"),
            "asked_unix_nanos": count("when it was asked for, since 1970 [ns]"),
            "answered_nanos": count("when it was answered, on the monotonic clock [ns]"),
            "change": text("the keys with their new values, as lines of TOML"),
            "outcome": text("applied or refused"),
            "reason": text("why it was refused"),
            "plant_epoch": count("epoch of the plant whose ticks these are"),
            "taken_at_tick": count("the period in which it was taken up"),
            "ready_at_tick": count("the period in which all that it needs had been checked and built"),
            "acts_from_tick": count("the first period for which all of it is in use"),
        },
    })
}

/// Looks for answers, and has them written.
#[derive(Debug)]
pub(crate) struct Changes {
    folder: PathBuf,
    answers: Answers,
    /// Which file of the record they go into.
    file: u64,
}

impl Changes {
    pub(crate) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), answers: Answers::all(folder), file: 1 }
    }

    /// Writes what is new, if it is time to look for it.
    ///
    /// # Errors
    /// [`RecordError`] in lock step.
    pub(crate) fn write_new(&mut self, store: &mut Store) -> Result<(), RecordError> {
        if self.file != store.files() {
            (self.file, self.answers) = (store.files(), Answers::all(&self.folder));
        }
        // What does not get into this file comes with the next.
        self.answers.look().iter().try_for_each(|settled| store.write_change(settled))
    }

    /// Writes what came last.
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
    fn everything_that_is_said_of_a_change_is_in_the_schema()
    -> Result<(), Box<dyn std::error::Error>> {
        let request = Request { who: "ada".into(), asked_unix_nanos: 1, change: "a = 1".into() };
        let applied = Outcome::Applied {
            plant_epoch: 1,
            taken_at_tick: 2,
            ready_at_tick: 2,
            acts_from_tick: 3,
        };
        for outcome in [applied, Outcome::Refused { reason: "no".into() }] {
            let answer = Answer { user: 0, answered_nanos: 5, outcome };
            let settled = Settled {
                process: "controller".into(),
                number: 1,
                request: request.clone(),
                answer,
            };
            let said = serde_json::to_value(&settled)?;
            let schema = schema();
            let known = schema["properties"].as_object().ok_or("no properties")?;
            assert!(
                said.as_object().ok_or("no object")?.keys().all(|key| known.contains_key(key)),
                "{said}"
            );
            assert_eq!(serde_json::from_value::<Settled>(said)?, settled);
        }
        Ok(())
    }
}
