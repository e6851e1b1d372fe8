//! Where those on the same machine find the endpoints: a file beside the sockets of the graph's links.

use std::fs;
use std::io;
use std::path::Path;

const NAME: &str = "telemetry";

/// The endpoints that the gateway of the graph in `root` listens on; empty if it has none.
pub fn endpoints(root: &Path) -> Vec<String> {
    let text = fs::read_to_string(root.join(NAME)).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

/// Says where the gateway of the graph in `root` listens: all of it, or nothing.
///
/// # Errors
/// What the file system says.
pub fn note(root: &Path, endpoints: &[String]) -> io::Result<()> {
    let half = root.join(format!("{NAME}.half"));
    fs::write(&half, endpoints.join("\n"))?;
    fs::rename(&half, root.join(NAME))
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
        assert_eq!(endpoints(root.path()), noted);
        Ok(())
    }
}
