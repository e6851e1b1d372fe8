//! Removes the remains of dead processes.

use super::half_made::HalfMade;
use super::room::FOLDER;
use super::{config, prefix};
use crate::{Links, OpenError};
use iceoryx2::node::{DeadNodeView, NodeCleanupFailure, NodeView};
use iceoryx2::prelude::{
    CallbackProgression, LogLevel, Node, NodeState, ipc_threadsafe, set_log_level,
};
use std::fs;
use std::io;
use std::path::Path;
use std::time::Duration;

/// How long to wait for another process that removes the same remains.
const CLEANUP_TIMEOUT: Duration = Duration::from_secs(5);

/// What a [`sweep`] found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SweepReport {
    /// Members of the graph that live, a stopped process included. While there are any, only the
    /// remains of dead members are removed.
    pub living: usize,
    /// Dead members whose remains were removed.
    pub dead: usize,
    /// Files removed beside them, because no living process could need them.
    pub files: usize,
}

/// Removes all remains of dead processes of a graph: their ports and memory, and the graph's files
/// if no member is left.
///
/// A process that is just joining does not count as living yet. A process that starts the members
/// of a graph sweeps before or after, not meanwhile.
///
/// # Errors
/// [`OpenError::Sweep`] if something cannot be removed; [`OpenError`] of the settings if they are
/// not valid.
pub fn sweep(links: &Links) -> Result<SweepReport, OpenError> {
    set_log_level(LogLevel::Fatal);
    let config = config(links)?;
    HalfMade::new(links).clear();
    let failed = |reason: String| OpenError::Sweep { graph: links.graph.clone(), reason };
    let mut report = SweepReport::default();
    let mut dead = Vec::new();
    Node::<ipc_threadsafe::Service>::list(&config, |node| {
        match node {
            NodeState::Alive(_) | NodeState::Inaccessible(_) => report.living += 1,
            NodeState::Dead(node) => dead.push(node),
            // Killed while it was made or removed: its files are removed with the rest.
            NodeState::Undefined(_) => {}
        }
        CallbackProgression::Continue
    })
    .map_err(|error| failed(error.to_string()))?;
    let mut stuck = None;
    for node in dead {
        match remove_dead(links, &node) {
            Ok(()) => report.dead += 1,
            Err(error) => stuck = Some(error),
        }
    }
    if report.living > 0 {
        if let Some(error) = stuck {
            return Err(failed(error.to_string()));
        }
    } else {
        // Remains that could not be removed in order are removed here.
        report.files = remove_files(links).map_err(|error| failed(error.to_string()))?;
    }
    Ok(report)
}

/// Removes one dead member: its ports, its places in the services, and its files.
///
/// A process that is killed just when it makes a port leaves a tag without its final permissions.
/// iceoryx2 0.10 does not recognise such a file as its own. Because of it, it fails to remove the
/// folder of the dead member, and keeps that member for ever. No resource stands behind an
/// unfinished tag, so the folder can be removed.
fn remove_dead(
    links: &Links,
    node: &DeadNodeView<ipc_threadsafe::Service>,
) -> Result<(), NodeCleanupFailure> {
    let remove = || node.clone().blocking_remove_stale_resources(CLEANUP_TIMEOUT);
    match remove() {
        Err(error @ NodeCleanupFailure::InternalError) => {
            fs::remove_dir_all(links.root.join("nodes").join(node.id().value().to_string()))
                .map_err(|_| error)?;
            remove()
        }
        other => other,
    }
}

/// Removes the files of a graph without living members, and its root if it contains nothing else.
fn remove_files(links: &Links) -> io::Result<usize> {
    let prefix = prefix(links);
    let mut removed = remove_prefixed(Path::new(FOLDER), &prefix)?;
    for folder in ["nodes", "services"] {
        removed += remove_folder(&links.root.join(folder))?;
    }
    removed += remove_prefixed(&links.root, &prefix)?;
    match fs::remove_dir(&links.root) {
        Err(error)
            if !matches!(
                error.kind(),
                io::ErrorKind::NotFound | io::ErrorKind::DirectoryNotEmpty
            ) =>
        {
            Err(error)
        }
        _ => Ok(removed),
    }
}

/// Removes the files in `folder` whose name begins with `prefix`.
fn remove_prefixed(folder: &Path, prefix: &str) -> io::Result<usize> {
    let mut removed = 0;
    for entry in absent_as_none(fs::read_dir(folder))?.into_iter().flatten() {
        let entry = entry?;
        if entry.file_name().to_str().is_some_and(|name| name.starts_with(prefix))
            && !entry.file_type()?.is_dir()
        {
            removed += usize::from(absent_as_none(fs::remove_file(entry.path()))?.is_some());
        }
    }
    Ok(removed)
}

/// Removes a folder that belongs to the carrier alone, and returns how many entries it had.
fn remove_folder(folder: &Path) -> io::Result<usize> {
    let entries = absent_as_none(fs::read_dir(folder))?.map_or(0, Iterator::count);
    absent_as_none(fs::remove_dir_all(folder))?;
    Ok(entries)
}

/// Another process may have removed it first.
fn absent_as_none<V>(result: io::Result<V>) -> io::Result<Option<V>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}
