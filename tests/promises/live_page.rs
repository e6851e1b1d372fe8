//! Promise: a browser shows the robot live while it learns, on any screen, and reconnects by
//! itself. On the robot's own machine it can stop the robot.
//!
//! With `COXSWAIN_PICTURE=1` in the environment it also takes the picture of the README,
//! `docs/images/live.png`.

use promises::{Browser, Launched, Outcome, Record, binaries, repository, signal};
use protocol::message::FallbackLevel;
use rustix::process::Signal;
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;

/// Pixels of `canvas` in the colour named `colour` in the style.
fn pixels(canvas: &str, colour: &str) -> String {
    pixels_within(canvas, colour, "canvas.width")
}

/// The same for its left part of width `width`.
fn pixels_within(canvas: &str, colour: &str, width: &str) -> String {
    format!(
        "(() => {{
            const canvas = document.getElementById('{canvas}');
            const probe = document.createElement('canvas').getContext('2d');
            probe.fillStyle = \
            getComputedStyle(document.documentElement).getPropertyValue('--{colour}').trim();
            probe.fillRect(0, 0, 1, 1);
            const wanted = probe.getImageData(0, 0, 1, 1).data;
            const {{data}} = canvas.getContext('2d').getImageData(0, 0, {width}, canvas.height);
            let count = 0;
            for (let at = 0; at < data.length; at += 4) {{
                count += data[at + 3] > 200 && \
                [0, 1, 2].every((part) => Math.abs(data[at + part] - wanted[part]) < 12);
            }}
            return count;
        }})()"
    )
}

fn open(launched: &Launched) -> Result<(Browser, String), Box<dyn Error>> {
    let address = launched.page_address()?;
    let mut browser = Browser::start()?;
    browser.open(&address, 1280, 1120)?;
    wait_for_live(&mut browser)?;
    Ok((browser, address))
}

fn wait_for_live(browser: &mut Browser) -> Outcome {
    browser.wait_for("document.getElementById('status').dataset.state === 'live'")
}

/// Waits until the list of events has one with these attributes.
fn wait_for_event(browser: &mut Browser, attributes: &str) -> Outcome {
    browser.wait_for(&format!("document.querySelector('#log li{attributes}') !== null"))
}

/// Waits until the robot has moved.
fn wait_for_movement(browser: &mut Browser) -> Outcome {
    let place = browser.text("place")?;
    browser.wait_for(&format!("document.getElementById('place').innerText !== {place:?}"))?;
    let place = browser.text("place")?;
    browser.wait_for(&format!("document.getElementById('place').innerText !== {place:?}"))
}

/// Asserts that all requests of the browser went to `address`, and that it reported no error but
/// lost connections.
fn is_self_contained(browser: &Browser, address: &str) {
    let elsewhere = |url: &&String| !url.starts_with(address) && !url.starts_with("data:");
    assert_eq!(browser.requested().iter().find(elsewhere), None);
    assert!(
        browser.requested().iter().any(|url| url.ends_with("/events")),
        "{:?}",
        browser.requested()
    );
    let serious: Vec<&String> =
        browser.complaints().iter().filter(|complaint| !complaint.contains("net::ERR_")).collect();
    assert!(serious.is_empty(), "{serious:?}");
}

#[test]
fn a_browser_sees_the_robot_move_and_learn_on_any_screen_in_any_light_and_by_keyboard() -> Outcome {
    let launched = Launched::new(&["--duration", "100"])?;
    let (mut browser, address) = open(&launched)?;
    wait_for_movement(&mut browser)?;
    for (chart, colour) in
        [("map", "with"), ("map", "horizon"), ("map", "reference"), ("map", "without")]
    {
        browser.wait_for(&format!("{} > 20", pixels(chart, colour)))?;
    }
    for chart in ["error-chart", "residual-chart", "tick-chart"] {
        let filled = browser.ask(&pixels(chart, "with"))?.as_u64().unwrap_or(0);
        browser.wait_for(&format!("{} > {}", pixels(chart, "with"), filled + 20))?;
    }
    for (id, value) in [("model", "version"), ("model-more", "samples"), ("compared", "ratio")] {
        browser
            .wait_for(&format!("Number(document.getElementById('{id}').dataset.{value}) >= 1"))?;
    }
    wait_for_fresh_plan(&mut browser)?;
    let processes = browser.text("processes")?;
    for who in ["plant", "controller", "learner", "recorder", "gateway"] {
        assert!(processes.contains(who), "{who} is not in {processes}");
    }

    browser.prefer("light")?;
    let light = browser.ask("getComputedStyle(document.body).backgroundColor")?;
    if std::env::var_os("COXSWAIN_PICTURE").is_some() {
        browser.wait_for("parseFloat(document.getElementById('time').innerText) > 16")?;
        fs::create_dir_all(repository().join("docs/images"))?;
        fs::write(repository().join("docs/images/live.png"), browser.picture()?)?;
    }
    browser.prefer("dark")?;
    let dark = browser.ask("getComputedStyle(document.body).backgroundColor")?;
    assert_ne!(light, dark);
    browser.wait_for(&format!("{} > 20", pixels("error-chart", "with")))?;

    let mut reached = BTreeSet::new();
    for _ in 0..12 {
        browser.press("Tab")?;
        let focus = "(({dataset, id}) => dataset.value || id)(document.activeElement)";
        let name = browser.ask(focus)?.as_str().unwrap_or_default().to_owned();
        if name == "whole" {
            browser.press("Space")?;
            browser.wait_for("document.activeElement.getAttribute('aria-pressed') === 'true'")?;
            let outline = browser.ask("getComputedStyle(document.activeElement).outlineStyle")?;
            assert_eq!(outline, "solid", "the focus is not seen");
        }
        reached.insert(name);
    }
    for control in ["stop", "follow", "close", "whole", "15", "60", "plane", "yaw", "pause", "log"]
    {
        assert!(reached.contains(control), "{control} is not in {reached:?}");
    }

    browser.resize(390, 844, true)?;
    browser.wait_for("innerWidth === 390")?;
    assert_eq!(
        browser.ask("document.documentElement.scrollWidth")?,
        390,
        "the page is wider than a phone"
    );
    wait_for_movement(&mut browser)?;
    is_self_contained(&browser, &address);
    drop(browser);
    signal(launched.pid(), Signal::TERM)?;
    let (ended, _home) = launched.end()?;
    assert!(ended.text.contains(&address), "{}", ended.text);
    Ok(())
}

#[test]
fn an_open_page_outlives_a_killed_gateway() -> Outcome {
    let launched = Launched::new(&["--duration", "100"])?;
    let (mut browser, address) = open(&launched)?;
    browser.wait_for(&format!("{} > 100", pixels("error-chart", "with")))?;
    let gateway = launched.process("gateway", None)?;
    signal(gateway, Signal::KILL)?;
    wait_for_event(&mut browser, "[data-code=disconnected]")?;
    wait_for_event(&mut browser, "[data-code=connected]")?;
    wait_for_live(&mut browser)?;
    wait_for_movement(&mut browser)?;
    // The new gateway has no data of the first seconds; the page still has.
    let first = pixels_within("error-chart", "with", "72");
    browser.wait_for(&format!(
        "parseFloat(document.getElementById('time').innerText) > 50 || {first} > 5"
    ))?;
    // A killed controller may return before a deadline is missed; one that hangs does not.
    let controller = launched.process("controller", None)?;
    signal(controller, Signal::STOP)?;
    wait_for_event(&mut browser, "[data-who=controller][data-code=restarted]")?;
    wait_for_event(&mut browser, "[data-code=level][data-sort=mended]")?;
    is_self_contained(&browser, &address);
    drop(browser);
    signal(launched.pid(), Signal::TERM)?;
    launched.end()?;
    Ok(())
}

/// Waits until the page shows that the newest plan drives the robot.
fn wait_for_fresh_plan(browser: &mut Browser) -> Outcome {
    let level = FallbackLevel::FreshPlan.code();
    let shown = "document.getElementById('fallback-level').dataset.level";
    browser.wait_for(&format!("{shown} === '{level}'"))
}

/// Waits until the page shows this state of its stop button.
fn wait_for_stop(browser: &mut Browser, state: &str) -> Outcome {
    browser.wait_for(&format!("document.getElementById('stop-bar').dataset.state === '{state}'"))
}

/// Asserts that the stop button can be hit wherever the page is scrolled to.
fn button_is_in_reach(browser: &mut Browser) -> Outcome {
    for place in ["0", "document.body.scrollHeight"] {
        browser.ask(&format!("scrollTo(0, {place})"))?;
        browser.wait_for(
            "(({x, y, width, height}) => height >= 48 &&
                document.elementFromPoint(x + width / 2, y + height / 2).id === 'stop')
                (document.getElementById('stop').getBoundingClientRect())",
        )?;
    }
    Ok(())
}

/// Status of a request to stop with the origin of the page, and without its token.
fn stop_without_token(address: &str) -> Result<String, Box<dyn Error>> {
    let host = address.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host)?;
    let headers = format!("Host: {host}\r\nOrigin: http://{host}\r\nContent-Length: 0");
    write!(stream, "POST /stop HTTP/1.1\r\n{headers}\r\n\r\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    Ok(answer.split(' ').nth(1).ok_or("no status")?.to_owned())
}

#[test]
fn a_press_of_the_stop_button_stops_the_robot_and_nothing_else_on_the_page_does() -> Outcome {
    let launched = Launched::new(&["--duration", "600"])?;
    let (mut browser, address) = open(&launched)?;
    wait_for_fresh_plan(&mut browser)?;
    assert_eq!(stop_without_token(&address)?, "403");
    // Without the focus on the button, a key has no effect.
    browser.press("Enter")?;
    browser.press("Space")?;
    wait_for_movement(&mut browser)?;
    wait_for_stop(&mut browser, "idle")?;

    button_is_in_reach(&mut browser)?;
    browser.press("Tab")?;
    assert_eq!(browser.ask("document.activeElement.id")?, "stop");
    browser.press("Enter")?;
    wait_for_stop(&mut browser, "stopped")?;
    let resumed = Command::new(binaries()?.join("coxswain"))
        .arg("resume")
        .env("TMPDIR", launched.home())
        .output()?;
    assert!(resumed.status.success(), "{resumed:?}");
    wait_for_stop(&mut browser, "idle")?;
    wait_for_movement(&mut browser)?;

    browser.resize(390, 844, true)?;
    browser.wait_for("innerWidth === 390")?;
    button_is_in_reach(&mut browser)?;
    // A press after a restart of the gateway has the new token.
    let gateway = launched.process("gateway", None)?;
    signal(gateway, Signal::KILL)?;
    wait_for_event(&mut browser, "[data-code=connected]")?;
    wait_for_live(&mut browser)?;
    browser.ask("document.getElementById('stop').click()")?;
    wait_for_stop(&mut browser, "stopped")?;
    is_self_contained(&browser, &address);
    drop(browser);

    signal(launched.pid(), Signal::TERM)?;
    let (_, home) = launched.end()?;
    let record = Record::read(&home.path().join("run"))?;
    let orders: Vec<_> = record
        .of("set")
        .map(|set| ["process", "change", "outcome"].map(|key| set.fields[key].as_str()))
        .collect();
    let order = |change| ["plant", change, "applied"].map(Some);
    assert_eq!(orders, ["stop", "resume", "stop"].map(order));
    let by_page: Vec<bool> = record.of("set").map(|set| set.fields["who"] == "page").collect();
    assert_eq!(by_page, [true, false, true]);
    let last = record.of("state").next_back().ok_or("no state")?;
    assert_eq!((last.word("gate"), last.word("stop")), ("stopped", "operator stop"));
    Ok(())
}
