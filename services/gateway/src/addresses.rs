//! Addresses of the endpoints and the live page for processes on this machine: files beside the
//! sockets of the graph's links.

use process::atomic_file;
use std::fs;
use std::io;
use std::net::SocketAddr;
use std::path::Path;

const TELEMETRY: &str = "telemetry";
const PAGE: &str = "page";

/// The endpoints that the gateway of the graph in `root` listens on; empty if it has none.
pub fn endpoints(root: &Path) -> Vec<String> {
    let text = fs::read_to_string(root.join(TELEMETRY)).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

/// Writes the endpoints of the gateway of the graph in `root`: all of them, or nothing.
///
/// # Errors
/// Errors of the file system.
pub fn note(root: &Path, endpoints: &[String]) -> io::Result<()> {
    write(root, TELEMETRY, &endpoints.join("\n"))
}

/// Address of the live page of the graph in `root`, if its gateway serves one.
pub fn page(root: &Path) -> Option<SocketAddr> {
    fs::read_to_string(root.join(PAGE)).ok()?.parse().ok()
}

/// Writes the address of the live page of the graph in `root`.
///
/// # Errors
/// Errors of the file system.
pub fn note_page(root: &Path, address: SocketAddr) -> io::Result<()> {
    write(root, PAGE, &address.to_string())
}

fn write(root: &Path, name: &str, text: &str) -> io::Result<()> {
    atomic_file::write(&root.join(name), text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_addresses_are_read_back() -> io::Result<()> {
        let root = tempfile::tempdir()?;
        assert_eq!(endpoints(root.path()), Vec::<String>::new());
        let noted = ["tcp/127.0.0.1:1".to_owned(), "tcp/127.0.0.1:2".to_owned()];
        note(root.path(), &noted)?;
        assert_eq!((endpoints(root.path()), page(root.path())), (noted.to_vec(), None));
        let address = SocketAddr::from(([127, 0, 0, 1], 8080));
        note_page(root.path(), address)?;
        assert_eq!(page(root.path()), Some(address));
        Ok(())
    }
}
