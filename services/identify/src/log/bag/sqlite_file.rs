//! A sqlite3 file of rosbag2 → topics and messages.
//!
//! It has the tables `topics` (id, name, type, serialization_format) and `messages` (topic_id,
//! timestamp, data). A file in which one of them is a view is refused: a view could compute without
//! end.

use super::BagError;
use super::files::{BYTES_MAX, Recorded, Take, Topic};
use crate::log::LogError;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

pub(super) fn topics(file: &Path) -> Result<BTreeSet<Topic>, LogError> {
    let database = open(file)?;
    let read = || -> rusqlite::Result<BTreeSet<Topic>> {
        let mut query = database.prepare(
            "SELECT name, type, serialization_format FROM topics \
             WHERE id IN (SELECT topic_id FROM messages)",
        )?;
        let topics = query.query_map([], |row| {
            Ok(Topic { name: row.get(0)?, kind: row.get(1)?, encoding: row.get(2)? })
        })?;
        topics.collect()
    };
    read().map_err(|source| failed(file, source))
}

pub(super) fn messages(file: &Path, wanted: &[&str], take: &mut Take<'_>) -> Result<(), LogError> {
    let database = open(file)?;
    let failed = |source| failed(file, source);
    let names = names(&database).map_err(failed)?;
    let mut query = database
        .prepare("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
        .map_err(failed)?;
    let mut rows = query.query([]).map_err(failed)?;
    while let Some(row) = rows.next().map_err(failed)? {
        let Some(topic) = names.get(&row.get(0).map_err(failed)?) else { continue };
        if !wanted.contains(&topic.as_str()) {
            continue;
        }
        let nanos = row.get(1).map_err(failed)?;
        let data = row.get_ref(2).map_err(failed)?;
        let bytes = data.as_blob().map_err(|error| failed(error.into()))?;
        take(&Recorded { topic, nanos, bytes })?;
    }
    Ok(())
}

fn failed(file: &Path, source: rusqlite::Error) -> LogError {
    BagError::Database { path: file.to_owned(), source }.into()
}

fn open(file: &Path) -> Result<Connection, LogError> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = || -> rusqlite::Result<(Connection, i64)> {
        let database = Connection::open_with_flags(file, flags)?;
        database
            .set_limit(Limit::SQLITE_LIMIT_LENGTH, i32::try_from(BYTES_MAX).unwrap_or(i32::MAX))?;
        database.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON")?;
        let tables = database.query_row(
            "SELECT count(*) FROM pragma_table_list WHERE schema = 'main' AND type = 'table' \
             AND name IN ('topics', 'messages')",
            [],
            |row| row.get(0),
        )?;
        Ok((database, tables))
    };
    match open().map_err(|source| failed(file, source))? {
        (database, 2) => Ok(database),
        _ => Err(BagError::Tables(file.to_owned()).into()),
    }
}

fn names(database: &Connection) -> rusqlite::Result<BTreeMap<i64, String>> {
    let mut query = database.prepare("SELECT id, name FROM topics")?;
    let names = query.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    names.collect()
}
