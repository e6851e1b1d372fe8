//! bytes → the request of a browser, or the reason for its refusal.

use std::io::{self, Read};
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// Longest request \[bytes\].
pub(super) const BYTES_MAX: usize = 8 * 1024;
/// Largest number of headers of a request.
const HEADERS_MAX: usize = 64;
/// Header of a request to stop. A script of another site would need a permission to send it.
const TOKEN: &str = "x-stop-token";
/// Time limit for the arrival of a request.
const ARRIVES_WITHIN: Duration = Duration::from_secs(5);

/// The available resources.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Asked {
    /// The page.
    Document,
    /// The events of the page.
    Events,
    /// A stop of the robot, by the button of the page.
    Stop {
        /// The token that the request contains.
        token: String,
    },
}

/// The reason for a refusal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Refusal {
    /// Not HTTP, or without a host.
    Malformed,
    /// A foreign host name, or another site's script.
    Foreign,
    /// The request to stop does not contain the token of this page.
    Token,
    /// The path does not exist.
    Nowhere,
    /// This page has no stop button.
    NoButton,
    /// Another method is required.
    Method {
        /// The method of this path.
        allowed: &'static str,
    },
    /// The request does not arrive in time.
    TooSlow,
    /// A request to stop with a body.
    Body,
    /// Longer than any browser's request.
    TooLong,
    /// All places are taken.
    Full,
}

impl Refusal {
    /// Status line without the version.
    pub(super) fn status(self) -> &'static str {
        match self {
            Self::Malformed => "400 Bad Request",
            Self::Foreign | Self::Token => "403 Forbidden",
            Self::Nowhere | Self::NoButton => "404 Not Found",
            Self::Method { .. } => "405 Method Not Allowed",
            Self::TooSlow => "408 Request Timeout",
            Self::Body => "413 Content Too Large",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::Full => "503 Service Unavailable",
        }
    }

    /// What was expected.
    pub(super) fn text(self) -> &'static str {
        match self {
            Self::Malformed => "expected a request of HTTP with one Host",
            Self::Foreign => "expected the Host and the Origin of this page",
            Self::Token => "expected the token of this page; try again, or reload the page",
            Self::Nowhere => "expected the path /, /events or /stop",
            Self::NoButton => "expected a page on the robot's own machine, of a run in real time",
            Self::Method { allowed: "POST" } => "expected POST",
            Self::Method { .. } => "expected GET",
            Self::TooSlow => "expected the whole request within 5 s",
            Self::Body => "expected no body",
            Self::TooLong => "expected at most 8 KiB and 64 headers",
            Self::Full => "expected fewer viewers at the same time",
        }
    }
}

/// Reads one request to `listening`, from a stream whose reads time out.
pub(super) fn read(stream: &mut impl Read, listening: IpAddr) -> Result<Asked, Refusal> {
    let begin = Instant::now();
    let mut bytes = Vec::with_capacity(1024);
    let mut part = [0; 1024];
    while begin.elapsed() < ARRIVES_WITHIN {
        let count = match stream.read(&mut part) {
            Ok(0) => return Err(Refusal::Malformed),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return Err(Refusal::TooSlow),
        };
        bytes.extend_from_slice(part.get(..count).unwrap_or_default());
        if let Some(asked) = parse(&bytes, listening)? {
            return Ok(asked);
        }
        if bytes.len() > BYTES_MAX {
            return Err(Refusal::TooLong);
        }
    }
    Err(Refusal::TooSlow)
}

/// Parses a request. Returns `None` while it is incomplete.
fn parse(bytes: &[u8], listening: IpAddr) -> Result<Option<Asked>, Refusal> {
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(bytes) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(httparse::Error::TooManyHeaders) => return Err(Refusal::TooLong),
        Err(_) => return Err(Refusal::Malformed),
    }
    let header = |name: &str| {
        let mut values =
            request.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
        let value =
            values.next().map(|header| std::str::from_utf8(header.value).unwrap_or("?").trim());
        if values.next().is_some() { Err(Refusal::Malformed) } else { Ok(value) }
    };
    let host = header("host")?.ok_or(Refusal::Malformed)?;
    // DNS rebinding: a page of another site whose name now resolves to this machine sends that name
    // as its host. It is refused.
    if !is_ours(host, listening) {
        return Err(Refusal::Foreign);
    }
    let path = request.path.and_then(|path| path.split('?').next());
    let allowed = if path == Some("/stop") { "POST" } else { "GET" };
    if request.method != Some(allowed) {
        return Err(Refusal::Method { allowed });
    }
    let site = header("sec-fetch-site")?;
    let origin = header("origin")?;
    let own_site = site.is_none_or(|site| matches!(site, "same-origin" | "none"));
    let own_origin = origin.is_none_or(|origin| origin.strip_prefix("http://") == Some(host));
    match path {
        Some("/") => Ok(Some(Asked::Document)),
        Some("/events" | "/stop") if !(own_site && own_origin) => Err(Refusal::Foreign),
        Some("/events") => Ok(Some(Asked::Events)),
        // Every browser sends the origin of a POST.
        Some("/stop") if origin.is_none() => Err(Refusal::Foreign),
        Some("/stop") => {
            let length = header("content-length")?.unwrap_or("0");
            if length != "0" || header("transfer-encoding")?.is_some() {
                return Err(Refusal::Body);
            }
            let token = header(TOKEN)?.ok_or(Refusal::Token)?.to_owned();
            Ok(Some(Asked::Stop { token }))
        }
        _ => Err(Refusal::Nowhere),
    }
}

/// Whether `host` can only mean this machine: one of its addresses, or `localhost`. Any port is
/// valid: it may have been forwarded.
fn is_ours(host: &str, listening: IpAddr) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next(),
        None => host.split(':').next(),
    };
    let Some(name) = name else { return false };
    let address = name.parse::<IpAddr>().ok();
    // A server on all addresses does not know them. An address, unlike a name, cannot be redirected
    // to another machine.
    let own = |address: IpAddr| {
        address.is_loopback() || address == listening || listening.is_unspecified()
    };
    name.eq_ignore_ascii_case("localhost") || address.is_some_and(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

    fn asked(text: &str) -> Result<Asked, Refusal> {
        read(&mut io::Cursor::new(text.as_bytes()), LOOPBACK)
    }

    #[test]
    fn only_the_page_and_its_events_are_available_and_only_by_get() {
        assert_eq!(asked("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n"), Ok(Asked::Document));
        assert_eq!(asked("GET /?again HTTP/1.1\r\nhost: LOCALHOST\r\n\r\n"), Ok(Asked::Document));
        assert_eq!(
            asked(
                "GET /events HTTP/1.1\r\nHost: [::1]:8080\r\nSec-Fetch-Site: same-origin\r\n\r\n"
            ),
            Ok(Asked::Events)
        );
        for path in ["/favicon.ico", "/events/", "/../etc/passwd", "//", "http://127.0.0.1/", "*"] {
            assert_eq!(
                asked(&format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n")),
                Err(Refusal::Nowhere),
                "{path}"
            );
        }
        for method in ["POST", "HEAD", "PUT", "DELETE", "OPTIONS", "get"] {
            assert_eq!(
                asked(&format!("{method} / HTTP/1.1\r\nHost: localhost\r\n\r\n")),
                Err(Refusal::Method { allowed: "GET" }),
                "{method}"
            );
        }
    }

    #[test]
    fn a_foreign_host_name_is_refused() {
        for host in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "10.0.0.1",
            "",
            "[",
        ] {
            assert_eq!(
                asked(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")),
                Err(Refusal::Foreign),
                "{host}"
            );
        }
        assert_eq!(asked("GET / HTTP/1.1\r\n\r\n"), Err(Refusal::Malformed), "no host");
        assert_eq!(
            asked("GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"),
            Err(Refusal::Malformed),
            "two hosts"
        );
        let everywhere = IpAddr::V4(Ipv4Addr::UNSPECIFIED);
        assert!(is_ours("10.0.0.1:80", everywhere) && !is_ours("evil.example:80", everywhere));
    }

    #[test]
    fn another_sites_script_gets_no_events() {
        for foreign in [
            "Sec-Fetch-Site: cross-site",
            "Sec-Fetch-Site: same-site",
            "Origin: http://evil.example",
            "Origin: null",
        ] {
            assert_eq!(
                asked(&format!("GET /events HTTP/1.1\r\nHost: localhost:1\r\n{foreign}\r\n\r\n")),
                Err(Refusal::Foreign),
                "{foreign}"
            );
        }
        assert_eq!(
            asked(
                "GET /events HTTP/1.1\r\nHost: localhost:1\r\nOrigin: http://localhost:1\r\n\r\n"
            ),
            Ok(Asked::Events)
        );
        assert_eq!(
            asked("GET / HTTP/1.1\r\nHost: localhost:1\r\nSec-Fetch-Site: cross-site\r\n\r\n"),
            Ok(Asked::Document),
            "a link"
        );
    }

    #[test]
    fn a_malformed_or_endless_request_is_refused() {
        for text in ["", "GET", "\0\0\0\0\r\n\r\n", "GET / HTTP/9\r\n\r\n", "nonsense\r\n\r\n"] {
            assert_eq!(asked(text), Err(Refusal::Malformed), "{text:?}");
        }
        let long = format!("GET / HTTP/1.1\r\nHost: localhost\r\nX: {}", "x".repeat(2 * BYTES_MAX));
        assert_eq!(asked(&long), Err(Refusal::TooLong));
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "A: b\r\n".repeat(HEADERS_MAX + 1));
        assert_eq!(asked(&many), Err(Refusal::TooLong));
    }
}
