//! Promise: short programs, in Python and in Rust, draw the tracking error live, and it equals that
//! of the record.

use promises::{
    Launched, Outcome, Reader, Record, binaries, python, repository, signal, wait_until,
};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::process::{Command, Stdio};

/// Half of the last printed digit, and a little for rounding.
const DIGIT_M: f64 = 0.5e-4 + 1e-9;

/// Both programs, without arguments.
fn programs() -> Result<[Command; 2], Box<dyn Error>> {
    let mut python = Command::new(python()?);
    python.arg("-B").arg(repository().join("deploy/clients/python/error_live.py"));
    Ok([python, Command::new(binaries()?.join("examples/error_live"))])
}

/// Tick, error \[m\] and length of the bar in a line.
fn parts(line: &str) -> Option<(u64, f64, usize)> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let ["tick", tick, "error", error, "m", bar @ ..] = words.as_slice() else { return None };
    let bar = bar.first().copied().unwrap_or_default();
    bar.chars().all(|sign| sign == '█').then_some((
        tick.parse().ok()?,
        error.parse().ok()?,
        bar.chars().count(),
    ))
}

/// The error in the record, by tick \[m\].
fn recorded(record: &Record) -> BTreeMap<u64, f64> {
    let error = |fields: &serde_json::Value| {
        let place = |row: &str, axis: usize| fields[row][0][axis].as_f64().unwrap_or(f64::NAN);
        (place("predicted", 0) - place("reference", 0))
            .hypot(place("predicted", 1) - place("reference", 1))
    };
    record.of("plan").map(|plan| (plan.stamp("tick"), error(&plan.fields))).collect()
}

#[test]
fn both_draw_the_error_of_the_record_and_end_on_ctrl_c() -> Outcome {
    let script = repository().join("deploy/clients/python/error_live.py");
    assert!(fs::read_to_string(script)?.lines().count() <= 60);
    let programs = programs()?;
    let launched = Launched::new(&["--duration", "20"])?;
    let endpoint = launched.gateway_endpoint()?;
    let mut drawn = Vec::new();
    for mut program in programs {
        let mut reader = Reader::start(program.args([endpoint.as_str(), "mecanum"]))?;
        drawn.push(reader.lines(15)?);
        signal(reader.pid(), Signal::INT)?;
        assert_eq!(reader.end()?.code(), Some(0), "{}", reader.errors());
        assert_eq!(reader.errors(), "");
    }
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let recorded = recorded(&Record::read(&home.path().join("run"))?);
    for lines in drawn {
        let parts: Vec<(u64, f64, usize)> = lines.iter().filter_map(|line| parts(line)).collect();
        assert_eq!(parts.len(), lines.len(), "{lines:?}");
        for (tick, error, bar) in parts {
            let true_error = *recorded.get(&tick).ok_or("a tick that nobody recorded")?;
            assert!(
                (error - true_error).abs() <= DIGIT_M,
                "tick {tick}: {error} was drawn, {true_error} is recorded"
            );
            // Five powers of ten on forty characters.
            let expected = 8.0 * (true_error.max(1e-4).log10() + 4.0);
            assert!(
                (bar as f64 - expected).abs() <= 0.51,
                "tick {tick}: {bar} signs for {true_error} m"
            );
        }
    }
    Ok(())
}

#[test]
fn both_print_their_usage() -> Outcome {
    for mut program in programs()? {
        let output = program.output()?;
        assert_eq!(output.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&output.stderr).contains("error_live"));
    }
    Ok(())
}

#[test]
fn both_report_a_missing_gateway() -> Outcome {
    for mut program in programs()? {
        let output = program.arg("tcp/127.0.0.1:1").output()?;
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains("tcp/127.0.0.1:1") && !text.contains("Traceback"), "{text}");
    }
    Ok(())
}

#[test]
fn both_report_an_unknown_robot() -> Outcome {
    let programs = programs()?;
    let launched = Launched::new(&["--duration", "60"])?;
    let endpoint = launched.gateway_endpoint()?;
    for mut program in programs {
        let output = program.args([endpoint.as_str(), "another"]).output()?;
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains(&endpoint) && !text.contains("Traceback"), "{text}");
    }
    Ok(())
}

#[test]
fn both_end_quietly_when_their_output_is_closed() -> Outcome {
    let programs = programs()?;
    let launched = Launched::new(&["--duration", "60"])?;
    let endpoint = launched.gateway_endpoint()?;
    for mut program in programs {
        let mut child = program
            .arg(&endpoint)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        drop(child.stdout.take());
        let ended = wait_until("the end of the program", || !matches!(child.try_wait(), Ok(None)));
        let _ = child.kill();
        ended?;
        let output = child.wait_with_output()?;
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    }
    Ok(())
}
