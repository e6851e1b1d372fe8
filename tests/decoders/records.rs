//! The points of a reference, the record of a run, its summary, and bags of ROS 2.

use super::settings::finite_along;
use super::{Fate, Verdict, as_file, either, promise, refused};
use controller::reference::{Heading, PathSettings, Reference, ReferenceSettings};
use identify::log::Log;
use identify::log::bag::Topics;
use recorder::rows::Rows;
use recorder::summary::Summary;
use recorder::{export, report};
use std::fs;
use supervisor::closing::Closing;

/// A file of points is refused with its name, or every number of its reference is finite.
pub(super) fn points(bytes: &[u8]) -> Verdict {
    as_file(bytes, |file| {
        let reference = |heading| {
            let settings = ReferenceSettings {
                path: PathSettings::Points { file: file.to_owned() },
                heading,
                ramp_s: 0.0,
                speed_factor: 1.0,
            };
            Reference::new(&settings, &[0.0; 3], 0.1, 30)
        };
        let mut fate = Fate::Refused;
        for heading in [Heading::Given, Heading::Tangent] {
            match reference(heading) {
                Ok(reference) => {
                    finite_along(&reference)?;
                    fate = Fate::Used;
                }
                Err(error) => {
                    let text = error.to_string();
                    promise(text.starts_with(&file.display().to_string()), || {
                        format!("which file was meant? {text}")
                    })?;
                    fate = either(fate, refused(&text)?);
                }
            }
        }
        Ok(fate)
    })
}

/// A record is read as far as possible, and summarised; the summary can be shown. Its page and its
/// tables are made, or refused.
pub(super) fn record(bytes: &[u8]) -> Verdict {
    as_file(bytes, |file| {
        // Twice: the second time, the existing content is skipped.
        let segments = [file.to_owned(), file.to_owned()];
        let rows =
            Rows::read(&segments).map_err(|error| format!("a record cannot be read: {error}"))?;
        let summed = serde_json::to_vec(&Summary::of(&rows, 100_000_000))
            .map_err(|error| format!("a summary cannot be written: {error}"))?;
        let closing: Closing = serde_json::from_slice(&summed)
            .map_err(|error| format!("a summary cannot be read: {error}"))?;
        promise(!closing.to_string().is_empty(), || "a summary says nothing".into())?;
        match report::page(&[file.to_owned()]) {
            Ok(page) => promise(page.ends_with("</html>\n"), || "half a page".into())?,
            Err(error) => {
                refused(&error.to_string())?;
            }
        }
        let home = tempfile::tempdir().map_err(|error| format!("no folder: {error}"))?;
        let tables = home.path().join("tables");
        match export::write(file, &tables) {
            Ok(_) => promise(tables.is_dir(), || "no tables".into())?,
            Err(error) => {
                refused(&error.to_string())?;
                promise(!tables.exists(), || "half of the tables".into())?;
            }
        }
        Ok(if rows.states.is_empty() { Fate::Refused } else { Fate::Used })
    })
}

/// A summary is refused, or can be shown.
pub(super) fn summary(bytes: &[u8]) -> Verdict {
    match serde_json::from_slice::<Closing>(bytes) {
        Ok(closing) => {
            promise(!closing.to_string().is_empty(), || "a summary says nothing".into())?;
            Ok(Fate::Used)
        }
        Err(error) => refused(&error.to_string()),
    }
}

/// A bag is refused with its name, or every number of its samples is finite.
pub(super) fn bag(bytes: &[u8]) -> Verdict {
    // sqlite3 opens no file that exists only in memory.
    let home = tempfile::tempdir().map_err(|error| format!("no folder: {error}"))?;
    let file = home.path().join("bag");
    fs::write(&file, bytes).map_err(|error| format!("no file: {error}"))?;
    let wheel_joints = ["front", "left", "rear", "right"].map(str::to_owned).to_vec();
    match Log::read(std::slice::from_ref(&file), &Topics { wheel_joints, ..Topics::default() }) {
        Ok(log) => {
            for sample in log.stretches.iter().flatten() {
                let wheels = sample.wheel_speed.unwrap_or_default();
                let mut numbers =
                    sample.pose.iter().chain(&sample.velocity).chain(&sample.input).chain(&wheels);
                promise(numbers.all(|number| number.is_finite()), || format!("{sample:?}"))?;
            }
            Ok(if log.is_empty() { Fate::Refused } else { Fate::Used })
        }
        Err(error) => {
            let text = error.to_string();
            promise(text.contains(&file.display().to_string()), || {
                format!("which file was meant? {text}")
            })?;
            refused(&text)
        }
    }
}
