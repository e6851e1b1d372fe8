//! Promise: invalid input gets an error with place, value and expectation, and no process is
//! started.

use promises::{Launched, Outcome, launch_command, repository};
use std::fs;
use std::path::Path;

/// Copies deploy/ to `to`, with `from` replaced by `by` in one of its files.
fn deploy_with(to: &Path, file: &str, from: &str, by: &str) -> Outcome {
    for folder in ["graphs", "robots", "scenarios"] {
        fs::create_dir_all(to.join(folder))?;
        let entries = fs::read_dir(repository().join("deploy").join(folder))?.flatten();
        for entry in entries.filter(|entry| entry.path().is_file()) {
            fs::copy(entry.path(), to.join(folder).join(entry.file_name()))?;
        }
    }
    let text = fs::read_to_string(to.join(file))?;
    assert!(text.contains(from), "{file} does not say {from:?}");
    Ok(fs::write(to.join(file), text.replacen(from, by, 1))?)
}

#[test]
fn each_wrong_setting_is_named_with_its_file_and_line_and_nothing_is_started() -> Outcome {
    for (file, from, by, expected) in [
        (
            "scenarios/paper.toml",
            "mass_kg = 22.0",
            "mass_kg = -22.0",
            ["paper.toml:", "mass_kg", "-22"],
        ),
        (
            "scenarios/paper.toml",
            "mass_kg = 22.0",
            "mass_pounds = 22.0",
            ["paper.toml:", "mass_pounds", "mass_kg"],
        ),
        (
            "scenarios/paper.toml",
            "horizon_steps = 5 ",
            "horizon_steps = 500",
            ["paper.toml:", "horizon_steps", "40"],
        ),
        (
            "scenarios/paper.toml",
            "speed_mps = 2.7",
            "speed_mps = \"fast\"",
            ["paper.toml:11", "speed_mps", "fast"],
        ),
        (
            "robots/mecanum.toml",
            "[wheels.mecanum]\nradius_m",
            "[geometry]\nwheel_radius_m",
            ["mecanum.toml:", "geometry", "[wheels.mecanum]"],
        ),
        (
            "robots/mecanum.toml",
            "track_m = 0.3 ",
            "track_m = 0.25\nrollers = \"X\" ",
            ["mecanum.toml:", "det(JᵀJ)", "0.01"],
        ),
        (
            "robots/mecanum.toml",
            "[wheels.mecanum]",
            "[response]\ntime_constant_s = [0.1, 0.1, 0.1]\n\n[wheels.mecanum]",
            ["mecanum.toml:", "[response]", "[drive]"],
        ),
        (
            "robots/mecanum.toml",
            "radius_m = 0.05",
            "radius_m = 0.0",
            ["mecanum.toml:6: wheels.mecanum.radius_m = 0.0", "0.0001", ""],
        ),
        (
            "robots/mecanum.toml",
            "[wheels.mecanum]",
            "[wheels.omni]\nradius_m = 0.05\ncentre_to_wheel_m = 0.2\ncount = 3\n\n\
             [wheels.mecanum]",
            ["mecanum.toml:", "mecanum and omni", "twist"],
        ),
        (
            "robots/mecanum.toml",
            "[wheels.mecanum]\nradius_m = 0.05     # the paper's r, table 1\n\
             wheelbase_m = 0.25  # twice the paper's b, table 1\n\
             track_m = 0.3       # twice the paper's a, table 1\n",
            "[wheels.omni]\nradius_m = 0.05\ncentre_to_wheel_m = 0.2\ncount = 2\n",
            ["mecanum.toml:", "wheels.omni.count = 2", "3 to 8"],
        ),
        (
            "graphs/local.toml",
            "pace = \"real-time\"",
            "pace = \"carrier-pigeon\"",
            ["local.toml:", "carrier-pigeon", "real-time"],
        ),
        ("graphs/local.toml", "paper.toml", "papyrus.toml", ["papyrus.toml", "", ""]),
        ("graphs/local.toml", "[telemetry]", "[telemetry", ["local.toml:", "", ""]),
        (
            "graphs/local.toml",
            "[telemetry]",
            "[links]\n[telemetry]",
            ["local.toml:", "links", "hosts"],
        ),
    ] {
        let home = tempfile::tempdir_in("/tmp")?;
        deploy_with(home.path(), file, from, by)?;
        let out = home.path().join("run");
        let output = launch_command(&home.path().join("graphs/local.toml"), &out, &[])?
            .env("TMPDIR", home.path())
            .output()?;
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{by}: {text}");
        for part in expected {
            assert!(text.contains(part), "{by}: {part:?} is not in: {text}");
        }
        assert!(!out.exists(), "{by}: a folder was made");
        assert!(text.trim().lines().count() <= 6, "{by}: too many words: {text}");
    }
    Ok(())
}

#[test]
fn an_impossible_fault_is_named_with_its_file_and_line_and_nothing_is_started() -> Outcome {
    let good = fs::read_to_string(repository().join("deploy/faults/example.toml"))?;
    for (from, by, pace, expected) in [
        (
            "kind = \"jitter\"",
            "kind = \"flutter\"",
            "real-time",
            ["faults.toml:11", "flutter", "jitter"],
        ),
        (
            "millis = 15",
            "milliseconds = 15",
            "real-time",
            ["faults.toml:12", "milliseconds", "millis"],
        ),
        (
            "probability = 0.3",
            "probability = 1.3",
            "real-time",
            ["faults.toml:16", "probability", "1.3"],
        ),
        (
            "field = \"velocity\"",
            "field = \"speed\"",
            "real-time",
            ["faults.toml:23", "speed", "velocity"],
        ),
        (
            "seed = 7",
            "seed = 7\nprocesses = 1",
            "real-time",
            ["faults.toml:6", "processes", "solver"],
        ),
        ("every_s = 4.0", "", "real-time", ["faults.toml:49", "every_s", "kill"]),
        (
            "sensor = \"velocity\"",
            "sensor = \"smell\"",
            "real-time",
            ["faults.toml:91", "smell", "everything"],
        ),
        ("seed = 7", "seed = 7", "lock-step", ["faults.toml:12", "millis", "messages"]),
    ] {
        let home = tempfile::tempdir_in("/tmp")?;
        let (file, out) = (home.path().join("faults.toml"), home.path().join("run"));
        assert!(good.contains(from), "{from}");
        fs::write(&file, good.replacen(from, by, 1))?;
        let options = ["--pace", pace, "--faults", &file.to_string_lossy()];
        let output =
            launch_command(&repository().join("deploy/graphs/local.toml"), &out, &options)?
                .env("TMPDIR", home.path())
                .output()?;
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{by}: {text}");
        for part in expected {
            assert!(text.contains(part), "{by}: {part:?} is not in: {text}");
        }
        assert!(!out.exists(), "{by}: a folder was made");
    }
    Ok(())
}

#[test]
fn a_folder_that_holds_another_run_is_refused() -> Outcome {
    let home = tempfile::tempdir_in("/tmp")?;
    fs::write(home.path().join("precious"), "data")?;
    let graph = repository().join("deploy/graphs/local.toml");
    let output = launch_command(&graph, home.path(), &[])?.output()?;
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(fs::read_to_string(home.path().join("precious"))?, "data");
    Ok(())
}

#[test]
fn a_wait_for_a_launch_that_refuses_to_start_returns_its_error() -> Outcome {
    let launched = Launched::new(&["--scenario", "papyrus"])?;
    let endpoint = launched.gateway_endpoint().map_err(|error| error.to_string());
    assert!(endpoint.as_ref().is_err_and(|text| text.contains("papyrus")), "{endpoint:?}");
    Ok(())
}
