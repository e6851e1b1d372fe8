//! Promise: only the intended readers can read the live page of a driving robot. Nothing can be
//! sent to the page but a stop with its token, and every name on it is plain text.

use graph::assembly::Assembly;
use graph::options::Options;
use promises::oracle::{Limits, acquit};
use promises::{
    Browser, Launched, Outcome, Record, binaries, graph_file, launch_command, repository, signal,
};
use rustix::process::Signal;
use std::error::Error;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::Duration;

/// Time for an answer. Far longer than needed.
const ANSWERS_WITHIN: Duration = Duration::from_mins(1);
/// A page would execute this if it were more than text.
const MARKUP: &str =
    "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'<script>";

/// Host and port of a page.
fn place(address: &str) -> &str {
    address.trim_start_matches("http://").trim_end_matches('/')
}

/// The complete answer to `bytes`, or its head alone if the answer has no end.
fn answer(place: &str, bytes: &[u8]) -> Result<String, Box<dyn Error>> {
    let mut stream = TcpStream::connect(place)?;
    stream.set_read_timeout(Some(ANSWERS_WITHIN))?;
    // A request that is refused early may find the connection closed.
    let _ = stream.write_all(bytes);
    let mut text = Vec::new();
    let mut part = [0; 4096];
    loop {
        match stream.read(&mut part) {
            Ok(0) => break,
            Ok(count) => text.extend_from_slice(part.get(..count).unwrap_or_default()),
            Err(error)
                if error.kind() == std::io::ErrorKind::ConnectionReset && !text.is_empty() =>
            {
                break;
            }
            Err(error) => return Err(error.into()),
        }
        let so_far = String::from_utf8_lossy(&text);
        if so_far.contains("text/event-stream") && so_far.contains("event: hello") {
            break;
        }
    }
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// A `GET` of `target` with these headers.
fn get(target: &str, headers: &str) -> String {
    format!("GET {target} HTTP/1.1\r\n{headers}\r\n\r\n")
}

/// Asserts the answers to its intended readers.
fn answers_its_readers(place: &str, own: &str) -> Outcome {
    let page = answer(place, get("/", own).as_bytes())?;
    let (head, body) = page.split_once("\r\n\r\n").ok_or("no body")?;
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && body.ends_with("</html>\n"), "{head}");
    let policy =
        head.lines().find(|line| line.starts_with("Content-Security-Policy: ")).unwrap_or_default();
    for expected in [
        "default-src 'none'",
        "frame-ancestors 'none'",
        "base-uri 'none'",
        "form-action 'none'",
        "connect-src 'self'",
        "script-src 'nonce-",
    ] {
        assert!(
            policy.contains(expected) && !policy.contains("unsafe"),
            "{expected} is not in {policy}"
        );
    }
    for header in [
        "X-Content-Type-Options: nosniff",
        "X-Frame-Options: DENY",
        "Referrer-Policy: no-referrer",
        "Cross-Origin-Resource-Policy: same-origin",
        "Cache-Control: no-store",
    ] {
        assert!(head.contains(header), "{header} is not in {head}");
    }
    assert!(!page.to_ascii_lowercase().contains("access-control-allow"));
    let events = answer(place, get("/events", own).as_bytes())?;
    assert!(
        events.contains("200 OK") && events.contains("\"robot\":\"mecanum\""),
        "{}",
        events.len()
    );
    Ok(())
}

/// Asserts that nothing can be sent.
fn takes_nothing(place: &str, own: &str) -> Outcome {
    let body = "Content-Length: 17\r\n\r\n{\"mpc\":{\"x\": 1}}\n";
    for method in
        ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PROPFIND", "get", "G"]
    {
        for target in ["/", "/events", "/set"] {
            let reply =
                answer(place, format!("{method} {target} HTTP/1.1\r\n{own}\r\n{body}").as_bytes())?;
            assert!(
                reply.starts_with("HTTP/1.1 405 ") && reply.contains("Allow: GET"),
                "{method} {target}: {reply}"
            );
        }
    }
    let own_origin = format!("{own}\r\nOrigin: http://{place}");
    for headers in [
        own.to_owned(),
        own_origin.clone(),
        format!("{own_origin}\r\nX-Stop-Token: {}", "0".repeat(32)),
        format!("{own}\r\nOrigin: http://evil.example"),
    ] {
        let stop = format!("POST /stop HTTP/1.1\r\n{headers}\r\n\r\n");
        let reply = answer(place, stop.as_bytes())?;
        assert!(reply.starts_with("HTTP/1.1 403 "), "{headers}: {reply}");
    }
    let reply = answer(place, get("/stop", &own_origin).as_bytes())?;
    assert!(reply.starts_with("HTTP/1.1 405 ") && reply.contains("Allow: POST"), "{reply}");
    let key = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==";
    let upgrade = format!(
        "{own}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n{key}\r\nOrigin: http://evil.example"
    );
    assert!(answer(place, get("/events", &upgrade).as_bytes())?.starts_with("HTTP/1.1 403 "));
    Ok(())
}

/// Asserts two refusals. A foreign name that resolves to this machine is not accepted, and a script
/// of another site gets no data of the robot.
fn refuses_strangers(place: &str, own: &str) -> Outcome {
    let port = place.rsplit(':').next().unwrap_or_default();
    for host in [
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "10.0.0.1",
        "[::2]",
        "0x7f000001",
        "2130706433",
        "127.1",
    ] {
        for (target, host) in [
            ("/", host.to_owned()),
            ("/", format!("{host}:{port}")),
            ("/events", format!("{host}:{port}")),
        ] {
            let reply = answer(place, get(target, &format!("Host: {host}")).as_bytes())?;
            assert!(
                reply.starts_with("HTTP/1.1 403 ") && !reply.contains("mecanum"),
                "{host}: {reply}"
            );
        }
    }
    for foreign in [
        "Sec-Fetch-Site: cross-site",
        "Sec-Fetch-Site: same-site",
        "Origin: http://evil.example",
        "Origin: null",
        "Origin: https://localhost",
    ] {
        let reply = answer(place, get("/events", &format!("{own}\r\n{foreign}")).as_bytes())?;
        assert!(
            reply.starts_with("HTTP/1.1 403 ") && !reply.contains("mecanum"),
            "{foreign}: {reply}"
        );
    }
    Ok(())
}

/// Asserts the refusal of unknown paths, and of bytes that are no request.
fn refuses_the_rest(place: &str, own: &str) -> Outcome {
    let elsewhere = [
        "/../../etc/passwd",
        "/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/settings/plant.toml",
        "/record.mcap",
        "http://127.0.0.1/",
        "*",
    ];
    for target in elsewhere {
        assert!(
            answer(place, get(target, own).as_bytes())?.starts_with("HTTP/1.1 404 "),
            "{target}"
        );
    }
    for headers in
        ["X: y", "Host: localhost\r\nHost: evil.example", "Host : localhost", "Host: local\0host"]
    {
        let reply = answer(place, get("/", headers).as_bytes())?;
        assert!(reply.starts_with("HTTP/1.1 400 "), "{headers:?}: {reply}");
    }
    let endless = format!("GET / HTTP/1.1\r\n{own}\r\nX: {}", "x".repeat(100_000));
    assert!(answer(place, endless.as_bytes())?.starts_with("HTTP/1.1 431 "));
    for garbage in [
        &b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"[..],
        b"\0\0\0\0\r\n\r\n",
        b"GET / HTTP/9\r\n\r\n",
        b"\xff\xfe\r\n\r\n",
    ] {
        let reply = answer(place, garbage)?;
        assert!(
            reply.starts_with("HTTP/1.1 400 ") || reply.starts_with("HTTP/1.1 408 "),
            "{garbage:?}: {reply}"
        );
    }
    Ok(())
}

#[test]
fn a_page_of_a_driving_robot_answers_its_own_readers_and_refuses_everything_else() -> Outcome {
    let launched = Launched::new(&["--duration", "110"])?;
    let address = launched.page_address()?;
    let place = place(&address);
    // The page may be served before the robot drives.
    launched.wait_for_controller(1)?;
    for check in [
        answers_its_readers,
        takes_nothing,
        refuses_strangers,
        refuses_the_rest,
        answers_its_readers,
    ] {
        check(place, &format!("Host: {place}"))?;
    }
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(143), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    acquit(&record, &Limits::of(&Assembly::read(&Options::of_graph(&graph_file("local")))?))?;
    assert_eq!(record.of("set").count(), 0, "nobody has changed anything");
    let states = record.of("state").count() as u64;
    assert_eq!(
        record.of("state").next_back().map(|state| state.stamp("tick") + 1),
        Some(states),
        "the robot did not notice"
    );
    Ok(())
}

/// Asserts that no part of `MARKUP` has become part of the page, which shows it as text.
fn is_text(browser: &mut Browser, shown: &str) -> Outcome {
    let elements =
        browser.ask("document.querySelectorAll('img, iframe, object, [onerror]').length")?;
    assert_eq!(elements, 0, "markup became an element");
    let title = browser.ask("document.title")?;
    assert_ne!(title, "owned", "a script ran");
    assert!(shown.contains(MARKUP), "{shown}");
    Ok(())
}

#[test]
fn a_name_with_markup_is_text_on_the_page_and_in_the_report() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let paper = fs::read_to_string(repository().join("deploy/scenarios/paper.toml"))?;
    let description =
        paper.lines().find(|line| line.starts_with("description")).ok_or("no description")?;
    let scenario = home.path().join(format!("{MARKUP}.toml"));
    fs::write(
        &scenario,
        paper.replacen(description, &format!("description = '''Described as {MARKUP}'''"), 1),
    )?;
    let options = ["--scenario", &scenario.to_string_lossy(), "--duration", "110"];
    let launched = Launched::by(
        launch_command(&graph_file("local"), &home.path().join("run"), &options)?,
        home,
    )?;
    let address = launched.page_address()?;
    let mut browser = Browser::start()?;
    browser.open(&address, 1280, 1120)?;
    browser.wait_for("/Described as/.test(document.getElementById('scenario').innerText)")?;
    let named = browser.text("scenario")?;
    assert_eq!(named.matches(MARKUP).count(), 2, "name and description: {named}");
    // The name of a person that changes a setting, and the reason of a refusal, are shown and
    // recorded, too.
    let mut set = Command::new(binaries()?.join("coxswain"));
    set.args(["set", &format!("mpc.solver={MARKUP}")])
        .env("TMPDIR", launched.home())
        .env("USER", MARKUP)
        .env_remove("SUDO_USER");
    launched.wait_for_controller(1)?;
    let refused = set.output()?;
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    browser.wait_for("/onerror/.test(document.getElementById('log').innerText)")?;
    let log = browser.text("log")?;
    is_text(&mut browser, &log)?;
    let serious: Vec<&String> =
        browser.complaints().iter().filter(|complaint| !complaint.contains("net::ERR_")).collect();
    assert!(serious.is_empty(), "{serious:?}");
    assert!(
        browser.requested().iter().all(|url| url.starts_with(&address) || url.starts_with("data:")),
        "{:?}",
        browser.requested()
    );
    drop(browser);

    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(143), "{}", ended.text);
    // The report names a run by its folder.
    let run = home.path().join(MARKUP);
    fs::rename(home.path().join("run"), &run)?;
    let page = home.path().join("both.html");
    let made = Command::new(binaries()?.join("coxswain"))
        .arg("report")
        .args([&run, &run])
        .arg("--out")
        .arg(&page)
        .output()?;
    assert!(made.status.success(), "{made:?}");
    let mut browser = Browser::start()?;
    browser.open(&format!("file://{}", page.display()), 1280, 900)?;
    let shown = browser.ask("document.body.textContent")?.as_str().unwrap_or_default().to_owned();
    assert!(shown.contains("mpc.solver"), "the change is among the events");
    is_text(&mut browser, &shown)?;
    assert_eq!(browser.ask("document.scripts.length")?, 0);
    assert_eq!(browser.requested().len(), 1, "{:?}", browser.requested());
    Ok(())
}
