//! Promise: a short script with the public Python package watches the robot.

use promises::{Launched, Outcome, Reader, python, repository};
use std::fs;
use std::process::Command;

#[test]
fn twenty_lines_of_python_print_the_state() -> Outcome {
    let script = repository().join("deploy/clients/python/watch.py");
    assert!(fs::read_to_string(&script)?.lines().count() <= 20);
    let python = python()?;
    let launched = Launched::new(&["--duration", "8"])?;
    let mut watcher = Reader::start(
        Command::new(python).arg(script).args([launched.gateway_endpoint()?.as_str(), "mecanum"]),
    )?;
    let lines = watcher.lines(10)?;
    let tick = |line: &String| {
        line.strip_prefix("tick").and_then(|rest| rest.split_whitespace().next()?.parse().ok())
    };
    let ticks: Vec<u64> = lines.iter().filter_map(tick).collect();
    assert_eq!(ticks.len(), 10, "{lines:?}");
    assert!(ticks.is_sorted_by(|earlier, later| earlier < later), "{ticks:?}");
    let last = lines.last().ok_or("no lines")?;
    assert!(last.contains("fresh plan") && last.contains("rad"), "{last}");
    let (ended, _home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    Ok(())
}
