//! Promise: every run leaves a page with every figure, whose numbers are those of its summary, for
//! any state of its record.

use bytemuck::Zeroable;
use experiment::in_process;
use graph::assembly::Assembly;
use graph::options::Options;
use process::Run;
use promises::{Browser, Launched, Outcome, binaries, repository};
use protocol::message::{FallbackLevel, Plan, PlantState, ResidualSample, Truth, WHEELS_MAX};
use recorder::segment::Segment;
use serde_json::Value;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;
use transport::Links;

const FIGURES: [&str; 9] = [
    "path",
    "errors",
    "velocities",
    "wheels",
    "residual",
    "versions",
    "band",
    "ticks",
    "fallback_levels",
];

/// Numbers of the table that are in the summary too.
const NUMBERS: [&str; 13] = [
    "arrival_s",
    "speed_settle_s",
    "steady_speed_error_mps",
    "position_rmse_m",
    "position_max_m",
    "heading_rmse_rad",
    "tick_p50_us",
    "tick_p99_us",
    "tick_max_us",
    "periods",
    "periods_missed",
    "snapshots_published",
    "snapshots_adopted",
];

/// A run of the paper's scenario in lock step and in one process, in a folder of this name.
fn run(
    home: &TempDir,
    name: &str,
    duration_s: f64,
    learner: bool,
) -> Result<std::path::PathBuf, Box<dyn Error>> {
    let mut options = Options::of_graph(&repository().join("deploy/graphs/local.toml"));
    (options.learner, options.duration) = (Some(learner), Some(duration_s));
    let folder = home.path().join(name);
    fs::create_dir(&folder)?;
    in_process::run(&Assembly::read(&options)?, &folder)?;
    Ok(folder)
}

fn report(records: &[&Path], out: &Path) -> Result<Output, Box<dyn Error>> {
    Ok(Command::new(binaries()?.join("coxswain"))
        .arg("report")
        .args(records)
        .arg("--out")
        .arg(out)
        .output()?)
}

/// The part of the page that is the figure `id`.
fn figure<'a>(page: &'a str, id: &str) -> Result<&'a str, String> {
    let from = page.split_once(&format!("<figure id=\"{id}\" data-figure=\"{id}\">"));
    let (_, from) = from.ok_or_else(|| format!("there is no figure {id}"))?;
    Ok(from.split_once("</figure>").map_or(from, |(figure, _)| figure))
}

/// Number of points in the lines of a class in a figure.
fn points(figure: &str, class: &str) -> usize {
    let lines = figure.split("<path class=\"").skip(1).filter(|path| path.starts_with(class));
    let data =
        lines.filter_map(|path| path.split_once("d=\"")?.1.split_once('"')).map(|(data, _)| data);
    // Each difference is two numbers, separated by a space or a minus.
    data.map(|data| data.matches(['l', ' ', '-', 'M']).count() / 2).sum()
}

/// The exact numbers of a row of the table, one per record.
fn cells(page: &str, key: &str) -> Result<Vec<String>, String> {
    let row = page
        .split_once(&format!("<tr data-key=\"{key}\">"))
        .ok_or_else(|| format!("there is no row {key}"))?
        .1;
    let row = row.split_once("</tr>").map_or(row, |(row, _)| row);
    Ok(row
        .split("data-value=\"")
        .skip(1)
        .filter_map(|cell| cell.split_once('"'))
        .map(|(value, _)| value.to_owned())
        .collect())
}

fn has_the_numbers_of(page: &str, column: usize, folder: &Path) -> Outcome {
    let summary: Value = serde_json::from_slice(&fs::read(folder.join("summary.json"))?)?;
    for key in NUMBERS {
        let shown = cells(page, key)?.get(column).cloned().unwrap_or_default();
        let shown = if shown.is_empty() { Value::Null } else { serde_json::from_str(&shown)? };
        assert_eq!(shown, summary[key], "{key}");
    }
    Ok(())
}

fn needs_nothing_else(page: &str) {
    for outside in ["<script", "src=", "href=", "url(", "@import", "<link"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.len() <= 3_000_000, "{} bytes", page.len());
}

#[test]
fn a_launch_leaves_a_page_with_every_figure_and_the_numbers_of_its_summary() -> Outcome {
    let (ended, home) = Launched::new(&["--pace", "lock-step", "--duration", "8"])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let folder = home.path().join("run");
    let file = folder.join("report.html");
    let named = file.canonicalize()?.display().to_string();
    assert!(ended.text.contains(&named), "{}", ended.text);
    let page = fs::read_to_string(file)?;
    for id in FIGURES {
        let figure = figure(&page, id)?;
        assert!(figure.contains("<svg") && figure.contains("<title>"), "{id} has no picture");
        let drawn = if id == "fallback_levels" {
            points(figure, "bar r0")
        } else {
            points(figure, "line r0") + points(figure, "line thin r0")
        };
        assert!(drawn >= if id == "fallback_levels" { 1 } else { 5 }, "{id} has {drawn} points");
        assert!(!figure.contains("NaN") && !figure.contains("inf"), "{id}");
        assert!(!figure.contains("class=\"note\""), "{id} lacks something");
    }
    assert!(points(figure(&page, "path")?, "line reference") > 50);
    assert!(points(figure(&page, "band")?, "band r0") > 10);
    has_the_numbers_of(&page, 0, &folder)?;
    for axis in 0..3 {
        let share: f64 = cells(&page, &format!("coverage_{axis}"))?.join("").parse()?;
        assert!((0.5..=1.0).contains(&share), "axis {axis}: {share}");
    }
    needs_nothing_else(&page);
    Ok(())
}

#[test]
fn in_a_browser_every_figure_is_visible_in_light_and_dark_and_nothing_else_is_requested() -> Outcome
{
    let home = tempfile::tempdir()?;
    let (on, off, out) = (
        run(&home, "on", 8.0, true)?,
        run(&home, "off", 8.0, false)?,
        home.path().join("both.html"),
    );
    let both = report(&[&on, &off], &out)?;
    assert!(both.status.success(), "{both:?}");
    let alone = report(&[&on], &on.join("report.html"))?;
    assert!(alone.status.success(), "{alone:?}");
    // Figures that also show the second record, in its own colour.
    let shared = ["path", "errors", "velocities", "wheels", "residual", "ticks", "fallback_levels"];
    for (page, second) in [(on.join("report.html"), &[][..]), (out, &shared[..])] {
        let address = format!("file://{}", page.canonicalize()?.display());
        let mut browser = Browser::start()?;
        browser.open(&address, 1280, 900)?;
        let mut grounds = Vec::new();
        for scheme in ["light", "dark"] {
            browser.prefer(scheme)?;
            grounds.push(browser.ask("getComputedStyle(document.body).backgroundColor")?);
            for (figures, colour) in [(&FIGURES[..], "c0"), (second, "c1")] {
                for id in figures {
                    let seen = browser.seen(&format!("#{id} .panels"), colour)?;
                    assert!(
                        seen > 50,
                        "{address}: {seen} pixels of {colour} in figure {id}, {scheme}"
                    );
                }
            }
        }
        assert_ne!(grounds.first(), grounds.last(), "light and dark are the same");
        browser.resize(390, 844, true)?;
        browser.wait_for("innerWidth === 390")?;
        assert_eq!(
            browser.ask("document.documentElement.scrollWidth")?,
            390,
            "the page is wider than a phone"
        );
        let elsewhere = |url: &&String| **url != address && !url.starts_with("data:");
        assert_eq!(browser.requested().iter().find(elsewhere), None);
        assert!(browser.complaints().is_empty(), "{:?}", browser.complaints());
    }
    Ok(())
}

#[test]
fn several_records_are_drawn_in_the_same_figures_and_have_a_column_each() -> Outcome {
    let home = tempfile::tempdir()?;
    let (on, off) = (run(&home, "on", 6.0, true)?, run(&home, "off", 6.0, false)?);
    let out = home.path().join("both.html");
    let output = report(&[&on, &off.join("record.mcap")], &out)?;
    assert!(output.status.success(), "{output:?}");
    assert_eq!(String::from_utf8(output.stdout)?.trim(), out.display().to_string());
    let page = fs::read_to_string(&out)?;
    for id in ["path", "errors", "velocities", "wheels", "residual", "versions", "ticks"] {
        let figure = figure(&page, id)?;
        assert!(figure.contains("on (") && figure.contains("off ("), "{id}");
        for record in ["line r0", "line r1"] {
            assert!(points(figure, record) >= 1, "{id}: {record}");
        }
    }
    let (_, note) = figure(&page, "band")?.split_once("<p class=\"note\">").ok_or("no note")?;
    assert!(note.starts_with("off ("), "{note:.40}");
    has_the_numbers_of(&page, 0, &on)?;
    has_the_numbers_of(&page, 1, &off)?;
    needs_nothing_else(&page);
    Ok(())
}

#[test]
fn a_truncated_record_is_read_as_far_as_possible_and_the_page_reports_it() -> Outcome {
    let home = tempfile::tempdir()?;
    let folder = run(&home, "cut", 10.0, true)?;
    let whole = fs::read(folder.join("record.mcap"))?;
    let cut = home.path().join("cut.mcap");
    let out = home.path().join("cut.html");
    for share in [0.9, 0.7] {
        fs::write(&cut, whole.get(..(share * whole.len() as f64) as usize).unwrap_or_default())?;
        let output = report(&[&cut], &out)?;
        assert!(output.status.success(), "{share}: {output:?}");
        let page = fs::read_to_string(&out)?;
        assert!(page.contains("data-note=\"ends-early\""));
        assert!(points(figure(&page, "path")?, "line r0") > 5, "{share}");
    }
    report(&[&folder], &out)?;
    assert!(!fs::read_to_string(&out)?.contains("data-note=\"ends-early\""));
    Ok(())
}

#[test]
fn a_file_that_is_no_record_is_refused_with_its_name_and_nothing_is_written() -> Outcome {
    let home = tempfile::tempdir()?;
    let at = |name: &str| home.path().join(name);
    fs::write(at("poem.mcap"), "The boy stood on the burning deck")?;
    fs::create_dir(at("empty"))?;
    Segment::create(&described(&at("silent"))?)?.finish()?;
    let record = run(&home, "good", 1.0, false)?.join("record.mcap");
    for (given, out, expected) in [
        (at("poem.mcap"), at("page.html"), "poem.mcap"),
        (at("nowhere.mcap"), at("page.html"), "nowhere.mcap"),
        (at("empty"), at("page.html"), "empty"),
        (at("silent"), at("page.html"), "\"state\""),
        (record.clone(), record.clone(), "record.mcap"),
    ] {
        let before = fs::read(&record)?;
        let output = report(&[&given], &out)?;
        let text = String::from_utf8(output.stderr)?;
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(expected), "{expected:?} is not in: {text}");
        assert_eq!(text.trim().lines().count(), 1, "{text}");
        assert!(!at("page.html").exists());
        assert!(fs::read(&record)? == before);
    }
    Ok(())
}

/// Settings of a recorder for a run in `folder`, at 50 Hz.
fn described(folder: &Path) -> Result<Run, Box<dyn Error>> {
    fs::create_dir_all(folder)?;
    let links = Links::on_this_machine("test", folder.to_owned(), true, 1000);
    Ok(Run::new(folder, 20_000_000, links))
}

/// Writes a record of `ticks` ticks at 50 Hz in which every number changes every time, the worst
/// case for a page. At tick 7777 the third wheel has a peak.
fn write_noise(folder: &Path, ticks: u64) -> Outcome {
    let mut segment = Segment::create(&described(folder)?)?;
    let (mut state, mut truth): (PlantState, Truth) = (Zeroable::zeroed(), Zeroable::zeroed());
    let (mut plan, mut sample): (Plan, ResidualSample) = (Zeroable::zeroed(), Zeroable::zeroed());
    let mut random: u64 = 7;
    let mut noise = || {
        random =
            random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    for tick in 0..ticks {
        for stamp in [&mut state.stamp, &mut truth.stamp, &mut plan.stamp, &mut sample.stamp] {
            (stamp.writer, stamp.epoch, stamp.tick, stamp.sequence) = (1, 1, tick, tick + 1);
        }
        let angle = 0.01 * tick as f64;
        truth.pose = [4.0 * angle.cos() + noise(), 2.0 * angle.sin() + noise(), noise()];
        truth.velocity = [noise(), noise(), noise()];
        (state.pose, state.velocity, state.accepted_epoch) = (truth.pose, truth.velocity, 1);
        (state.wheels, state.wheel_speed_valid) = (4, 1);
        state.wheel_speed = [0.0; WHEELS_MAX];
        for (wheel, speed) in state.wheel_speed.iter_mut().take(4).enumerate() {
            let drawn = noise();
            *speed = if wheel == 2 && tick == 7777 { 40.0 } else { drawn };
        }
        state.fallback_level = if noise() > 0.49 {
            FallbackLevel::StoredTail.code()
        } else {
            FallbackLevel::FreshPlan.code()
        };
        (plan.plant_epoch, plan.model_version, plan.learned_axes) = (1, 1 + tick / 25, 7);
        plan.tick_nanos = (1e6 * (1.0 + noise())) as u64;
        (plan.residual, plan.innovation) =
            ([noise(), noise(), noise()], [noise(), noise(), noise()]);
        plan.reference[0] =
            [4.0 * angle.cos(), 2.0 * angle.sin(), noise(), noise(), noise(), noise()];
        plan.variance[0] = [0.02 + 0.01 * noise(); 3];
        (sample.plant_epoch, sample.usable) = (1, 1);
        segment.write(&state)?;
        segment.write(&truth)?;
        segment.write(&plan)?;
        segment.write(&sample)?;
    }
    Ok(segment.finish()?)
}

/// The largest upward step of a panel's lines.
fn leap(panel: &str) -> Option<i32> {
    panel.split(['l', ' ']).filter_map(|word| word.rsplit_once('-')?.1.parse().ok()).max()
}

#[test]
fn an_hour_at_fifty_hertz_is_a_page_of_three_megabytes_at_most_with_its_one_peak() -> Outcome {
    let home = tempfile::tempdir()?;
    let (hour, out) = (home.path().join("hour"), home.path().join("hour.html"));
    write_noise(&hour, 180_000)?;
    let output = report(&[&hour], &out)?;
    assert!(output.status.success(), "{output:?}");
    let page = fs::read_to_string(&out)?;
    needs_nothing_else(&page);
    let leaps: Vec<Option<i32>> =
        figure(&page, "wheels")?.split("<svg role").skip(1).map(leap).collect();
    let [_, _, Some(with), Some(without)] = leaps.as_slice() else {
        return Err(format!("{leaps:?}").into());
    };
    assert!(*with > 1000 && *without < 200, "the peak of the third wheel: {leaps:?}");
    Ok(())
}

#[test]
fn many_records_on_one_page_are_three_megabytes_at_most() -> Outcome {
    let home = tempfile::tempdir()?;
    let (noisy, out) = (home.path().join("noisy"), home.path().join("many.html"));
    write_noise(&noisy, 10_000)?;
    let output = report(&[noisy.as_path(); 12], &out)?;
    assert!(output.status.success(), "{output:?}");
    let page = fs::read_to_string(&out)?;
    needs_nothing_else(&page);
    assert_eq!(cells(&page, "periods")?.len(), 12);
    Ok(())
}
