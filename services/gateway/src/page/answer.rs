//! page, events, refusals → bytes. The page contains everything that it needs, and loads nothing
//! from elsewhere.

use super::request::Refusal;
use super::stop::StopError;
use serde_json::json;
use std::hash::{BuildHasher, RandomState};

const HTML: &str = include_str!("index.html");
const STYLE: &str = include_str!("style.css");
/// In the order of their dependencies.
const SCRIPT: &str = concat!(
    "(() => {\n\"use strict\";\n",
    include_str!("store.js"),
    include_str!("stream.js"),
    include_str!("canvas.js"),
    include_str!("map.js"),
    include_str!("chart.js"),
    include_str!("figures.js"),
    include_str!("stop.js"),
    include_str!("main.js"),
    "})();\n"
);

/// Headers of every answer.
const ALWAYS: &str = "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
    Referrer-Policy: no-referrer\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\nConnection: close\r\n";

/// The page. `nonce` permits its own script and style, and no other.
pub(super) fn document(nonce: &str) -> String {
    let body = HTML.replace("{nonce}", nonce).replace("{style}", STYLE).replace("{script}", SCRIPT);
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; \
         connect-src 'self'; img-src data:; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'"
    );
    format!(
        "HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nContent-Length: {}\r\n\
         Content-Security-Policy: {policy}\r\n\
         X-Frame-Options: DENY\r\n{ALWAYS}\r\n{body}",
        body.len()
    )
}

/// The text before the feed: the token of the stop button, if the page has one. A browser that
/// loses the connection connects again after half a second.
pub(super) fn events(token: Option<&str>) -> String {
    let stop = event("stop", &json!({ "token": token }).to_string());
    format!(
        "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n{ALWAYS}\r\n{stop}retry: 500\n\n"
    )
}

/// The answer to a refused request.
pub(super) fn refusal(refusal: Refusal) -> String {
    let allow = match refusal {
        Refusal::Method { allowed } => format!("Allow: {allowed}\r\n"),
        _ => String::new(),
    };
    text(refusal.status(), &allow, refusal.text())
}

/// The answer to the stop button: the tick from which on the gate is stopped, or the error.
pub(super) fn stopped(outcome: Result<u64, StopError>) -> String {
    match outcome {
        Ok(tick) => text("200 OK", "", &format!("the gate is stopped from tick {tick} on")),
        Err(error) => text(error.status(), "", &error.to_string()),
    }
}

/// One line as plain text, with more `headers`.
fn text(status: &str, headers: &str, line: &str) -> String {
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\n\
         Content-Length: {}\r\n{headers}\
         Content-Security-Policy: default-src 'none'\r\n{ALWAYS}\r\n{line}\n",
        line.len() + 1
    )
}

/// One event called `name` with the content `json`, which has one line.
pub(super) fn event(name: &str, json: &str) -> String {
    format!("event: {name}\ndata: {json}\n\n")
}

/// 128 unpredictable bits: hashes under random keys of the system.
pub(super) fn nonce() -> String {
    let draw = || RandomState::new().hash_one("nonce");
    format!("{:016x}{:016x}", draw(), draw())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_pages_own_script_and_style_run_and_every_page_has_another_nonce() {
        let (one, other) = (nonce(), nonce());
        assert!(one != other && one.len() == 32);
        let page = document(&one);
        let policy = page
            .lines()
            .find(|line| line.starts_with("Content-Security-Policy: "))
            .unwrap_or_default();
        assert!(
            policy.contains("default-src 'none'") && policy.contains("frame-ancestors 'none'"),
            "{policy}"
        );
        assert!(!policy.contains("unsafe") && policy.matches(&one).count() == 2, "{policy}");
        let body = page.split("\r\n\r\n").nth(1).unwrap_or_default();
        assert_eq!(body.matches(&format!("nonce=\"{one}\"")).count(), 2);
        assert!(!body.contains("{style}") && !body.contains("{script}"));
    }

    #[test]
    fn the_page_loads_nothing_from_elsewhere_and_shows_no_name_as_markup() {
        for part in [HTML, STYLE, SCRIPT] {
            for forbidden in [
                "http://",
                "https://",
                "//cdn",
                "@import",
                "url(",
                "innerHTML",
                "insertAdjacentHTML",
                "document.write",
                "eval(",
            ] {
                let own = forbidden.starts_with("http")
                    && part.matches(forbidden).count()
                        == part.matches("http://www.w3.org/2000/svg").count();
                assert!(!part.contains(forbidden) || own, "{forbidden}");
            }
        }
        for attribute in [" onclick", " onload", " style=\""] {
            assert!(!HTML.contains(attribute), "{attribute}: the policy forbids it");
        }
    }

    #[test]
    fn the_content_length_is_the_length_of_the_body() {
        let method = Refusal::Method { allowed: "GET" };
        let not_stopped = Err(StopError::Rejected { reason: "größer".into() });
        for answer in [
            document("n"),
            refusal(method),
            refusal(Refusal::Nowhere),
            stopped(Ok(7)),
            stopped(not_stopped),
        ] {
            let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_default();
            assert!(head.contains(&format!("Content-Length: {}", body.len())), "{head}");
        }
        assert!(refusal(method).contains("Allow: GET"));
    }
}
