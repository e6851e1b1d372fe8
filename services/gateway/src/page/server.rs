//! browsers ⇄ page: one thread that accepts connections, and one for each connection.

use super::answer;
use super::request::{self, Asked, Refusal};
use super::stop::StopButton;
use super::viewers::{VIEWERS_MAX, Viewers};
use process::Repeated;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Largest number of connections: viewers, and as many that fetch the page.
const CONNECTIONS_MAX: usize = 2 * VIEWERS_MAX;
/// Longest pause of a browser within its request.
const READS_WITHIN: Duration = Duration::from_secs(2);
/// Longest time that a browser may block a write before it is disconnected.
const WRITES_WITHIN: Duration = Duration::from_secs(10);
/// Time between two checks of the request to stop.
const PATIENCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };

/// Serves the page until it is dropped.
#[derive(Debug)]
pub(super) struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    viewers: Viewers,
    connections: AtomicUsize,
    closing: AtomicBool,
    /// Only of a page that no other machine can reach.
    button: Option<StopButton>,
    refused: Mutex<Repeated<Refusal>>,
}

impl Shared {
    /// The stop button of a viewer at `peer`, if it has one.
    fn button(&self, peer: IpAddr) -> Option<&StopButton> {
        self.button.as_ref().filter(|_| peer.is_loopback())
    }

    /// Counts a refused request. The log has a line of each kind at most every ten seconds.
    fn note(&self, refusal: Refusal) {
        let mut refused = self.refused.lock().unwrap_or_else(PoisonError::into_inner);
        refused.note(refusal, 1);
        log(&refused.due(Instant::now()));
    }
}

/// Logs refused requests, with their numbers.
fn log(refused: &[(Refusal, u64)]) {
    for (refusal, requests) in refused {
        let (status, reason) = (refusal.status(), refusal.text());
        tracing::warn!(requests, status, "the page refused requests: {reason}");
    }
}

impl Server {
    /// Listens at `address`. On the loopback the page has a stop button for the run in `stops`.
    pub(super) fn open(address: SocketAddr, stops: Option<&Path>) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        // A connection that has closed between the poll and here must not block.
        listener.set_nonblocking(true)?;
        let stops = stops.filter(|_| address.ip().is_loopback());
        let button = stops.map(StopButton::new).transpose()?;
        let shared = Arc::new(Shared { button, ..Shared::default() });
        let address = listener.local_addr()?;
        let thread = {
            let shared = Arc::clone(&shared);
            thread::Builder::new()
                .name("page".into())
                .spawn(move || let_in(&listener, address.ip(), &shared))?
        };
        Ok(Self { address, shared, thread: Some(thread) })
    }

    /// The served address, with the actual port.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// The open pages.
    pub(super) fn viewers(&self) -> &Viewers {
        &self.shared.viewers
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.closing.store(true, Ordering::Release);
        self.shared.viewers.close();
        log(&self.shared.refused.lock().unwrap_or_else(PoisonError::into_inner).rest());
        if let Some(thread) = self.thread.take() {
            // A panic of that thread is in the log.
            let _ = thread.join();
        }
    }
}

/// A connection that is counted during the lifetime of this value.
struct Counted(Arc<Shared>);

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

fn let_in(listener: &TcpListener, ip: IpAddr, shared: &Arc<Shared>) {
    while !shared.closing.load(Ordering::Acquire) {
        // The result does not matter: the next round polls again.
        let _ = poll(&mut [PollFd::new(listener, PollFlags::IN)], Some(&PATIENCE));
        match listener.accept() {
            Ok((stream, peer)) => welcome(stream, ip, peer.ip(), shared),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            // For example too many open files. The error is temporary, and meanwhile the poll
            // returns at once.
            Err(_) => thread::sleep(Duration::from_millis(100)),
        }
    }
}

/// Starts a thread for a connection, if there is room.
fn welcome(mut stream: TcpStream, ip: IpAddr, peer: IpAddr, shared: &Arc<Shared>) {
    let prepared = stream.set_nonblocking(false).and_then(|()| stream.set_nodelay(true));
    let prepared = prepared.and_then(|()| stream.set_read_timeout(Some(READS_WITHIN)));
    if prepared.and_then(|()| stream.set_write_timeout(Some(WRITES_WITHIN))).is_err() {
        return;
    }
    let counted = Counted(Arc::clone(shared));
    if shared.connections.fetch_add(1, Ordering::AcqRel) >= CONNECTIONS_MAX {
        shared.note(Refusal::Full);
        // Small enough for any socket's buffer.
        let _ = stream.write_all(answer::refusal(Refusal::Full).as_bytes());
        return;
    }
    let serve = move || {
        let counted = counted;
        // A browser that has disconnected is not an error.
        let _ = serve(stream, ip, peer, &counted.0);
    };
    if let Err(error) = thread::Builder::new().name("viewer".into()).spawn(serve) {
        tracing::warn!(%error, "a viewer of the page was not served");
    }
}

fn serve(mut stream: TcpStream, ip: IpAddr, peer: IpAddr, shared: &Shared) -> io::Result<()> {
    let refuse = |mut stream: TcpStream, refusal| {
        shared.note(refusal);
        stream.write_all(answer::refusal(refusal).as_bytes())
    };
    let button = shared.button(peer);
    match request::read(&mut stream, ip) {
        Ok(Asked::Document) => stream.write_all(answer::document(&answer::nonce()).as_bytes()),
        Ok(Asked::Events) => {
            let Some(viewer) = shared.viewers.join(stream.try_clone()?) else {
                return refuse(stream, Refusal::Full);
            };
            let begin = answer::events(button.map(StopButton::token));
            let served = stream.write_all(begin.as_bytes()).and_then(|()| {
                while let Some(event) = viewer.next() {
                    stream.write_all(event.as_bytes())?;
                }
                Ok(())
            });
            shared.viewers.leave(&viewer);
            served
        }
        Ok(Asked::Stop { token }) => {
            let Some(button) = button else { return refuse(stream, Refusal::NoButton) };
            if !button.opens_with(&token) {
                return refuse(stream, Refusal::Token);
            }
            let outcome = button.press(|| !shared.closing.load(Ordering::Acquire));
            match &outcome {
                Ok(tick) => tracing::info!(tick, "the stop button of the page stopped the gate"),
                Err(error) => tracing::warn!(%error, "the stop button of the page failed"),
            }
            stream.write_all(answer::stopped(outcome).as_bytes())
        }
        Err(refusal) => refuse(stream, refusal),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;
    use std::io::{BufRead, BufReader, Read};
    use std::time::Instant;

    const PATIENCE: Duration = Duration::from_mins(1);

    fn open() -> io::Result<Server> {
        Server::open(SocketAddr::from(([127, 0, 0, 1], 0)), None)
    }

    fn ask(server: &Server, text: &str) -> io::Result<TcpStream> {
        let mut stream = TcpStream::connect(server.address())?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.write_all(text.as_bytes())?;
        Ok(stream)
    }

    fn answer_to(server: &Server, text: &str) -> io::Result<String> {
        let mut answer = String::new();
        ask(server, text)?.read_to_string(&mut answer)?;
        Ok(answer)
    }

    /// An open page that is connected, and has received no event yet.
    fn viewer(server: &Server) -> io::Result<BufReader<TcpStream>> {
        let mut stream =
            BufReader::new(ask(server, "GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")?);
        let mut line = String::new();
        while !line.starts_with("retry: ") {
            line.clear();
            if stream.read_line(&mut line)? == 0 || line.contains("503") {
                return Err(io::Error::other("not let in"));
            }
        }
        Ok(stream)
    }

    #[test]
    fn the_page_is_served_and_everything_else_refused() -> io::Result<()> {
        let server = open()?;
        let page = answer_to(&server, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")?;
        assert!(
            page.starts_with("HTTP/1.1 200 OK\r\n") && page.ends_with("</html>\n"),
            "{}",
            page.len()
        );
        assert!(
            !page.to_ascii_lowercase().contains("access-control-allow"),
            "other sites may not read it"
        );
        for (text, status) in [
            ("GET /secret HTTP/1.1\r\nHost: localhost\r\n\r\n", "404"),
            ("POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc", "405"),
            ("GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n", "403"),
            ("hello\r\n\r\n", "400"),
        ] {
            let answer = answer_to(&server, text)?;
            assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{text}: {answer}");
        }
        Ok(())
    }

    #[test]
    fn only_a_viewer_on_this_machine_has_the_stop_button() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let server = Server::open(SocketAddr::from(([127, 0, 0, 1], 0)), Some(folder.path()))?;
        for (peer, has_button) in
            [("127.0.0.1", true), ("127.9.9.9", true), ("::1", true), ("10.0.0.1", false)]
        {
            assert_eq!(server.shared.button(peer.parse()?).is_some(), has_button, "{peer}");
        }
        Ok(())
    }

    #[test]
    fn a_blocked_viewer_delays_neither_the_gateway_nor_the_others() -> io::Result<()> {
        let server = open()?;
        let blocked = viewer(&server)?;
        let mut quick = viewer(&server)?;
        // Far more than sockets can buffer.
        let news: Arc<str> = answer::event("news", &"x".repeat(1_000_000)).into();
        let mut received = 0_usize;
        let mut bytes = vec![0; 1_000_000];
        // If its thread is not scheduled, the fast viewer falls behind as well. Then its queue is
        // cleared, and it receives the next event.
        quick.get_ref().set_read_timeout(Some(Duration::from_millis(100)))?;
        let begin = Instant::now();
        while received < 30_000_000 {
            server.viewers().tell(Some(&news), || Arc::clone(&news));
            match quick.read(&mut bytes) {
                Ok(0) => return Err(io::Error::other("the quick one was sent away")),
                Ok(count) => received += count,
                Err(error)
                    if error.kind() == io::ErrorKind::WouldBlock && begin.elapsed() < PATIENCE => {}
                Err(error) => return Err(error),
            }
        }
        drop(blocked);
        Ok(())
    }

    #[test]
    fn one_viewer_too_many_is_refused_and_the_others_continue() -> io::Result<()> {
        let server = open()?;
        let mut present =
            (0..VIEWERS_MAX).map(|_| viewer(&server)).collect::<io::Result<Vec<_>>>()?;
        assert!(viewer(&server).is_err());
        assert!(
            answer_to(&server, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")?
                .starts_with("HTTP/1.1 200"),
            "the page itself is served"
        );
        server.viewers().tell(None, || "event: hello\n\n".into());
        for stream in &mut present {
            let mut line = String::new();
            while line.trim().is_empty() {
                line.clear();
                stream.read_line(&mut line)?;
            }
            assert_eq!(line, "event: hello\n");
        }
        Ok(())
    }

    #[test]
    fn a_closed_page_frees_its_place() -> io::Result<()> {
        let server = open()?;
        drop((0..VIEWERS_MAX).map(|_| viewer(&server)).collect::<io::Result<Vec<_>>>()?);
        let begin = Instant::now();
        let news: Arc<str> = "event: news\n\n".into();
        while viewer(&server).is_err() {
            assert!(begin.elapsed() < PATIENCE, "no place was free again");
            server.viewers().tell(Some(&news), || Arc::clone(&news));
            thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    #[test]
    fn a_restarted_server_can_use_the_same_address() -> io::Result<()> {
        let server = open()?;
        let (address, open_page) = (server.address(), viewer(&server)?);
        drop(server);
        let again = Server::open(address, None)?;
        assert_eq!(again.address(), address);
        drop(open_page);
        viewer(&again).map(drop)
    }
}
