//! Promise: a record's tables hold every message of it, to the last digit, with units. They are
//! written whole or not at all.

use csv::{Reader, StringRecord};
use promises::{Launched, Outcome, Record, binaries};
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn export(record: &Path, tables: &Path) -> Result<Output, Box<dyn Error>> {
    Ok(Command::new(binaries()?.join("coxswain"))
        .arg("export")
        .arg(record)
        .arg("--csv")
        .arg(tables)
        .output()?)
}

fn table(file: &Path) -> Result<(StringRecord, Vec<StringRecord>), Box<dyn Error>> {
    let mut reader = Reader::from_path(file)?;
    let header = reader.headers()?.clone();
    Ok((header, reader.records().collect::<Result<_, _>>()?))
}

/// The column called `name`.
fn column<'a>(
    header: &StringRecord,
    rows: &'a [StringRecord],
    name: &str,
) -> Result<Vec<&'a str>, String> {
    let index = header
        .iter()
        .position(|column| column == name)
        .ok_or_else(|| format!("{name} is not in {header:?}"))?;
    Ok(rows.iter().filter_map(|row| row.get(index)).collect())
}

#[test]
fn tables_read_back_have_a_row_for_every_message_and_its_very_numbers() -> Outcome {
    let (ended, home) = Launched::new(&["--pace", "lock-step", "--duration", "4"])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let (run, tables) = (home.path().join("run"), home.path().join("deep/tables"));
    let output = export(&run, &tables)?;
    assert!(output.status.success(), "{output:?}");
    let record = Record::read(&run)?;
    for topic in ["state", "truth", "command", "plan", "residual", "snapshot", "health"] {
        let (header, rows) = table(&tables.join(topic).with_extension("csv"))?;
        assert_eq!(rows.len(), record.of(topic).count(), "{topic}");
        assert!(rows.iter().all(|row| row.len() == header.len()));
        let ticks = column(&header, &rows, "stamp_tick")?;
        assert!(
            ticks
                .iter()
                .map(|tick| tick.parse::<u64>().ok())
                .eq(record.of(topic).map(|message| Some(message.stamp("tick")))),
            "{topic}"
        );
    }
    let (header, rows) = table(&tables.join("state.csv"))?;
    for (index, name) in ["pose_0 [m]", "pose_1 [m]", "pose_2 [rad]"].into_iter().enumerate() {
        let read = column(&header, &rows, name)?.into_iter().map(|cell| cell.parse::<f64>().ok());
        assert!(
            read.eq(record.of("state").map(|state| state.numbers("pose").get(index).copied())),
            "{name}"
        );
    }
    let fallback_levels = column(&header, &rows, "fallback_level")?;
    assert!(
        fallback_levels
            .into_iter()
            .eq(record.of("state").map(|state| state.word("fallback_level")))
    );
    let (header, rows) = table(&tables.join("plan.csv"))?;
    for name in
        ["predicted_5_3 [m/s]", "variance_0_2 [(rad/s)²]", "tick_nanos [ns]", "delay_micros [µs]"]
    {
        assert_eq!(column(&header, &rows, name)?.len(), rows.len());
    }
    Ok(())
}

#[test]
fn no_table_is_written_into_a_full_folder_or_from_a_file_that_is_no_record() -> Outcome {
    let home = tempfile::tempdir()?;
    let (full, poem, tables) =
        (home.path().join("full"), home.path().join("poem.mcap"), home.path().join("tables"));
    fs::create_dir(&full)?;
    fs::write(full.join("mine.csv"), "1,2,3")?;
    fs::write(&poem, "The boy stood on the burning deck")?;
    for (record, folder, expected) in [
        (&poem, &full, "full: expected a new or empty folder"),
        (&poem, &tables, "poem.mcap: expected a record"),
        (&full, &tables, "full: expected a record, or the folder of a run"),
    ] {
        let output = export(record, folder)?;
        let text = String::from_utf8(output.stderr)?;
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(expected), "{expected:?} is not in: {text}");
    }
    let left: Vec<_> =
        fs::read_dir(home.path())?.flatten().map(|entry| entry.file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
    assert_eq!(fs::read_dir(&full)?.count(), 1);
    Ok(())
}
