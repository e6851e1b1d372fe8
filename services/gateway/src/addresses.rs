//! Where those on the same machine find the endpoints and the live page: files beside the sockets of the graph's links.

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

/// Says where the gateway of the graph in `root` listens: all of it, or nothing.
///
/// # Errors
/// What the file system says.
pub fn note(root: &Path, endpoints: &[String]) -> io::Result<()> {
    write(root, TELEMETRY, &endpoints.join("\n"))
}

/// Where the gateway of the graph in `root` serves the live page, if it does.
pub fn page(root: &Path) -> Option<SocketAddr> {
    fs::read_to_string(root.join(PAGE)).ok()?.parse().ok()
}

/// Says where the gateway of the graph in `root` serves the live page.
///
/// # Errors
/// What the file system says.
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
    fn what_is_noted_is_found() -> io::Result<()> {
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
