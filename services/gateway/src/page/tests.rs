//! Events of an open page, from messages to JSON.

use super::Page;
use crate::comparison::{self, Row};
use crate::settings::{About, PageSettings, Rates, Settings};
use bytemuck::Zeroable;
use network::telemetry::TelemetrySettings;
use process::requests::{Inbox, Outcome as Reply, welcome};
use process::{Pace, Run};
use protocol::message::{
    FallbackLevel, Goal, GoalKind, GoalPhase, Health, Participant, Phase, Plan, PlantState,
};
use serde_json::Value;
use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};
use transport::Links;

type Outcome = Result<(), Box<dyn Error>>;

fn settings(folder: &Path, without_learning: Option<&Path>) -> Settings {
    let links = Links::on_this_machine("test", folder, true, 1000);
    Settings {
        run: Run::new(folder, 100_000_000, links),
        has_plant: true,
        telemetry: TelemetrySettings {
            listen: vec!["tcp/127.0.0.1:0".into()],
            robot: "</script><b>".into(),
            credentials: None,
        },
        rates: Rates::default(),
        page: PageSettings { listen: "127.0.0.1:0".into() },
        about: About {
            scenario: "paper".into(),
            without_learning: without_learning.map(Path::to_owned),
            ..About::default()
        },
    }
}

/// A browser without a window.
struct Tab {
    stream: BufReader<TcpStream>,
}

impl Tab {
    fn open(page: &Page) -> Result<Self, Box<dyn Error>> {
        Ok(Self::with_token(page)?.0)
    }

    /// The tab, and the token of the stop button, if the page has one.
    fn with_token(page: &Page) -> Result<(Self, Option<String>), Box<dyn Error>> {
        let port = page.address().port();
        let mut stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_read_timeout(Some(Duration::from_mins(1)))?;
        write!(stream, "GET /events HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n")?;
        let mut tab = Self { stream: BufReader::new(stream) };
        let (name, stop) = tab.event()?;
        assert_eq!(name, "stop");
        while !tab.line()?.starts_with("retry:") {}
        Ok((tab, stop["token"].as_str().map(str::to_owned)))
    }

    fn line(&mut self) -> Result<String, Box<dyn Error>> {
        let mut line = String::new();
        if self.stream.read_line(&mut line)? == 0 {
            return Err("the stream has ended".into());
        }
        Ok(line.trim_end().to_owned())
    }

    /// Name and content of the next event.
    fn event(&mut self) -> Result<(String, Value), Box<dyn Error>> {
        loop {
            if let Some(name) = self.line()?.strip_prefix("event: ") {
                let data = self.line()?;
                return Ok((
                    name.to_owned(),
                    serde_json::from_str(data.strip_prefix("data: ").ok_or("no data")?)?,
                ));
            }
        }
    }
}

fn state(tick: u64, epoch: u64, fallback_level: FallbackLevel) -> PlantState {
    let mut state = PlantState {
        fallback_level: fallback_level.code(),
        pose: [tick as f64, 0.0, 0.0],
        ..PlantState::zeroed()
    };
    (state.stamp.tick, state.stamp.epoch, state.stamp.writer) = (tick, epoch, epoch);
    state
}

fn plan(tick: u64, plant_epoch: u64, error: f64) -> Box<Plan> {
    let mut plan: Box<Plan> =
        Box::new(Plan { plant_epoch, horizon: 5, model_version: 7, ..Plan::zeroed() });
    plan.stamp.tick = tick;
    plan.predicted[0][0] = error;
    plan
}

fn length(value: &Value) -> usize {
    value.as_array().map_or(0, Vec::len)
}

#[test]
fn a_goal_is_shown_to_late_viewers_and_each_change_of_its_phase_is_an_entry() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut page = Page::open(&settings(folder.path(), None), None)?.ok_or("no page")?;
    page.feed().receive_state(&state(0, 1, FallbackLevel::FreshPlan));
    let mut goal =
        Goal { id: 3, target: [2.0, 1.0, 0.5], left_m: 1.5, progress: 0.5, ..Goal::zeroed() };
    goal.kind = GoalKind::Pose.code();
    page.feed().receive_goal(&goal);
    page.feed().receive_goal(&goal);
    let mut tab = Tab::open(&page)?;
    page.turn(Instant::now());
    let (_, hello) = tab.event()?;
    let expected = serde_json::json!({
        "id": 3, "kind": "pose", "phase": "active", "target": [2.0, 1.0, 0.5],
        "progress": 0.5, "left_m": 1.5, "left_s": 0.0,
    });
    for (key, value) in expected.as_object().into_iter().flatten() {
        assert_eq!(hello["goal"][key], *value, "{key}");
    }
    assert_eq!(length(&hello["entries"]), 1);
    goal.phase = GoalPhase::Reached.code();
    page.feed().receive_goal(&goal);
    page.turn(Instant::now() + Duration::from_secs(1));
    let (_, news) = tab.event()?;
    assert_eq!(news["goal"]["phase"], "reached");
    assert_eq!(length(&news["entries"]), 1);
    Ok(())
}

#[test]
fn a_late_viewer_receives_the_path_so_far_and_then_the_news() -> Outcome {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("without.csv");
    comparison::write(
        &file,
        &[0, 1, 2].map(|tick| Row { tick, x_m: 0.0, y_m: 1.0, error_m: 2.0 }),
    )?;
    let mut page = Page::open(&settings(folder.path(), Some(&file)), None)?.ok_or("no page")?;
    let begin = Instant::now();
    let after = |tick: u64| begin + Duration::from_millis(100 * (tick + 1));
    for tick in 0..50 {
        page.feed().receive_state(&state(tick, 1, FallbackLevel::FreshPlan));
        page.feed().receive_plan(&plan(tick, 1, 1.0));
        page.turn(after(tick));
    }
    let mut tab = Tab::open(&page)?;
    page.turn(after(50));
    let (name, hello) = tab.event()?;
    assert_eq!(
        (name.as_str(), length(&hello["states"]), length(&hello["plans"])),
        ("hello", 50, 50)
    );
    assert_eq!(
        (hello["robot"].as_str(), hello["about"]["scenario"].as_str()),
        (Some("</script><b>"), Some("paper"))
    );
    assert_eq!(hello["without"][2], serde_json::json!([0.2, 0.0, 1.0, 2.0]));
    assert_eq!(hello["compared"], serde_json::json!({"since": 0, "with": 1.0, "without": 2.0}));
    assert!(!hello.to_string().contains("without.csv"), "no path of this machine is told");
    page.feed().receive_state(&state(51, 1, FallbackLevel::FreshPlan));
    page.feed().receive_plan(&plan(51, 1, 0.5));
    page.feed().receive_plan(&plan(9, 0, 9.0));
    page.turn(after(51));
    let (name, news) = tab.event()?;
    assert_eq!(
        (name.as_str(), length(&news["states"]), length(&news["plans"])),
        ("news", 1, 1),
        "{news}"
    );
    assert_eq!(
        (&news["plans"][0][3], length(&news["horizon"]["predicted"])),
        (&serde_json::json!(0.5), 6)
    );
    Ok(())
}

#[test]
fn another_epoch_of_the_plant_begins_a_new_path_and_events_are_reported() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut page = Page::open(&settings(folder.path(), None), None)?.ok_or("no page")?;
    let begin = Instant::now();
    let mut health = Health {
        participant: Participant::Plant.code(),
        phase: Phase::Running.code(),
        pid: 1,
        ..Health::zeroed()
    };
    page.feed().receive_health(&health, begin);
    for tick in 0..10 {
        page.feed().receive_state(&state(
            tick,
            1,
            if tick < 5 { FallbackLevel::FreshPlan } else { FallbackLevel::Brake },
        ));
    }
    health.pid = 2;
    page.feed().receive_health(&health, begin);
    page.feed().receive_state(&state(0, 2, FallbackLevel::Waiting));
    let mut tab = Tab::open(&page)?;
    page.turn(begin + Duration::from_secs(2));
    let (_, hello) = tab.event()?;
    assert_eq!((length(&hello["states"]), hello["run"].as_str()), (1, Some("2-2")));
    let codes: Vec<[&str; 2]> = hello["entries"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|entry| ["code", "sort"].map(|key| entry[key].as_str().unwrap_or_default()))
        .collect();
    let expected =
        [["level", "fault"], ["restarted", "mended"], ["level", "note"], ["silent", "fault"]];
    assert_eq!(codes, expected);
    assert_eq!(hello["processes"][0]["silent"], serde_json::json!(true));
    Ok(())
}

#[test]
fn a_page_that_is_off_is_not_served_and_one_that_cannot_be_served_reports_its_address() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut settings = settings(folder.path(), None);
    let page = Page::open(&settings, None)?.ok_or("no page")?;
    settings.page.listen = page.address().to_string();
    let error = Page::open(&settings, None).err().ok_or("two pages at one address")?.to_string();
    assert!(
        error.starts_with(&format!("the live page cannot be served at {}: ", page.address())),
        "{error}"
    );
    settings.page.listen = "off".into();
    assert!(Page::open(&settings, None)?.is_none());
    Ok(())
}

/// A page of a run in real time, whose plant is on this host.
fn with_stop_button(folder: &Path) -> Result<Page, Box<dyn Error>> {
    let mut settings = settings(folder, None);
    settings.run.pace = Pace::RealTime;
    Page::open(&settings, None)?.ok_or_else(|| "no page".into())
}

/// Status of the answer to a request that begins with `line` and has these headers. It may have
/// been refused before all of it was read.
fn status(page: &Page, line: &str, headers: &[&str], body: &str) -> Result<u16, Box<dyn Error>> {
    let mut stream = TcpStream::connect(("127.0.0.1", page.address().port()))?;
    stream.set_read_timeout(Some(Duration::from_mins(1)))?;
    let request = format!("{line} HTTP/1.1\r\n{}\r\n\r\n{body}", headers.join("\r\n"));
    stream.write_all(request.as_bytes())?;
    let mut head = [0; 12];
    stream.read_exact(&mut head)?;
    let status = std::str::from_utf8(&head)?.strip_prefix("HTTP/1.1 ").ok_or("not HTTP")?;
    Ok(status.parse()?)
}

/// Number of orders to the plant.
fn orders(folder: &Path) -> Result<usize, Box<dyn Error>> {
    Ok(std::fs::read_dir(folder.join("set"))?.count())
}

#[test]
fn the_stop_button_orders_a_stop_and_reports_the_reply_of_the_plant() -> Outcome {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    let page = with_stop_button(folder.path())?;
    let (_tab, token) = Tab::with_token(&page)?;
    let own = page.address().to_string();
    let (host, origin) = (format!("Host: {own}"), format!("Origin: http://{own}"));
    let token = format!("X-Stop-Token: {}", token.ok_or("no token")?);
    let links = Links::on_this_machine("test", folder.path(), false, 0);
    let run = Run::new(folder.path(), 100_000_000, links);
    let followed =
        Reply::Applied { plant_epoch: 1, taken_at_tick: 7, ready_at_tick: 7, acts_from_tick: 7 };
    let refused = Reply::refused("run-ended", &"the run has ended");
    for (reply, expected) in [(followed, 200), (refused, 409)] {
        let mut plant = Inbox::open(&run, Participant::Plant);
        let plant = thread::spawn(move || {
            loop {
                if let Some(request) = plant.take() {
                    plant.answer(reply);
                    break request.map(|request| (request.who, request.change));
                }
                thread::sleep(Duration::from_millis(2));
            }
        });
        assert_eq!(status(&page, "POST /stop", &[&host, &origin, &token], "")?, expected);
        let request = plant.join().map_err(|_| "the plant panicked")??;
        assert_eq!(request, ("page".to_owned(), "stop".to_owned()));
    }
    Ok(())
}

#[test]
fn a_stop_without_the_token_from_another_site_or_with_a_body_is_refused() -> Outcome {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    let page = with_stop_button(folder.path())?;
    let (_tab, token) = Tab::with_token(&page)?;
    let (own, token) = (page.address().to_string(), token.ok_or("no token")?);
    let (host, origin) = (format!("Host: {own}"), format!("Origin: http://{own}"));
    let other = if token.starts_with('0') { '1' } else { '0' };
    let wrong = format!("X-Stop-Token: {other}{}", &token[1..]);
    let token = format!("X-Stop-Token: {token}");
    let (host, origin, token) = (host.as_str(), origin.as_str(), token.as_str());
    let other_port = "Origin: http://127.0.0.1:1";
    let long = "x".repeat(4000);
    let refused: [(&str, &[&str], &str, u16); 18] = [
        ("POST /stop", &[host, origin], "", 403),
        ("POST /stop", &[host, origin, &wrong], "", 403),
        ("POST /stop", &[host, origin, "X-Stop-Token:"], "", 403),
        ("POST /stop", &[host, origin, token, token], "", 400),
        ("POST /stop", &[host, token], "", 403),
        ("POST /stop", &[host, "Origin: http://evil.example", token], "", 403),
        ("POST /stop", &[host, "Origin: null", token], "", 403),
        ("POST /stop", &[host, other_port, token], "", 403),
        ("POST /stop", &[host, origin, "Sec-Fetch-Site: cross-site", token], "", 403),
        ("POST /stop", &[host, origin, "Sec-Fetch-Site: same-site", token], "", 403),
        ("POST /stop", &["Host: evil.example", "Origin: http://evil.example", token], "", 403),
        ("POST /stop", &[origin, token], "", 400),
        ("POST /stop", &[host, origin, token, "Content-Length: 4000"], &long, 413),
        ("POST /stop", &[host, origin, token, "Transfer-Encoding: chunked"], "", 413),
        ("GET /stop", &[host, origin, token], "", 405),
        ("OPTIONS /stop", &[host, "Origin: http://evil.example"], "", 405),
        ("POST /", &[host, origin, token], "", 405),
        ("POST /resume", &[host, origin, token], "", 405),
    ];
    for (line, headers, body, expected) in refused {
        assert_eq!(status(&page, line, headers, body)?, expected, "{line} {headers:?}");
    }
    assert_eq!(orders(folder.path())?, 0);
    Ok(())
}

#[test]
fn only_a_page_of_a_real_run_on_the_host_of_the_plant_has_a_stop_button() -> Outcome {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    for (why, has_plant, pace, listen) in [
        ("another host has the plant", false, Pace::RealTime, "127.0.0.1:0"),
        ("the gate takes no orders in lock step", true, Pace::LockStep, "127.0.0.1:0"),
        ("other machines reach the page", true, Pace::RealTime, "0.0.0.0:0"),
    ] {
        let mut settings = settings(folder.path(), None);
        (settings.has_plant, settings.run.pace) = (has_plant, pace);
        settings.page.listen = listen.into();
        let page = Page::open(&settings, None)?.ok_or("no page")?;
        let (_tab, token) = Tab::with_token(&page)?;
        assert_eq!(token, None, "{why}");
        let own = format!("127.0.0.1:{}", page.address().port());
        let (host, origin) = (format!("Host: {own}"), format!("Origin: http://{own}"));
        let headers = [host.as_str(), &origin, "X-Stop-Token: 0"];
        assert_eq!(status(&page, "POST /stop", &headers, "")?, 404, "{why}");
    }
    assert_eq!(orders(folder.path())?, 0);
    Ok(())
}
