//! The highest epoch of each role, on disk, so that no restarted process uses an earlier epoch.

use process::atomic_file;
use protocol::message::Participant;
use serde::Deserialize;
use settings::{Check, Impossible};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use transport::Identity;

/// Highest epoch that has a successor in TOML, whose integers are signed.
const EPOCH_MAX: u64 = i64::MAX as u64 - 1;

/// Highest assigned or observed epoch of each role. Every change is written to disk before it is
/// used. If the disk is full, the robot drives on, and the launcher keeps the epochs in memory.
#[derive(Debug)]
pub struct Epochs {
    file: PathBuf,
    /// Whether the file lacks the last changes.
    behind: bool,
    /// Lower limit of the epochs of all roles.
    floor: u64,
    highest: BTreeMap<String, u64>,
}

/// Number of random low bits in an epoch that no earlier run has used. Together with the seconds of
/// this century the epoch is a number that every JSON reader keeps exactly.
const DRAWN_BITS: u32 = 21;

/// An epoch that no earlier run has used, so that a delayed command for the plant of another run is
/// not valid in this one.
///
/// The time alone is not unique: a machine without a clock may start with the time of its last
/// shutdown. So a part is random. The epoch grows with the time, so that launches that meet use the
/// later one.
pub fn unused_epoch(since_1970: Duration) -> u64 {
    let drawn = Identity::new(0).writer & ((1 << DRAWN_BITS) - 1);
    (since_1970.as_secs() << DRAWN_BITS | drawn).min(EPOCH_MAX)
}

/// Contents of the file, by role.
#[derive(Debug, Default, Deserialize)]
#[serde(transparent)]
struct EpochsFile(BTreeMap<String, u64>);

impl Check for EpochsFile {
    fn check(&self) -> Result<(), Impossible> {
        let last = self.0.iter().find(|&(_, &epoch)| epoch > EPOCH_MAX);
        last.map_or(Ok(()), |(role, _)| {
            Err(Impossible::new(
                role,
                format!("at most {EPOCH_MAX}, above which TOML has no next epoch"),
            ))
        })
    }
}

impl Epochs {
    /// The epochs in `file`; `floor` if there is no such file, or where its values are lower.
    ///
    /// # Errors
    /// If the file exists but cannot be read.
    pub fn open(file: &Path, floor: u64) -> io::Result<Self> {
        let EpochsFile(highest) = if file.try_exists()? {
            settings::read(file).map_err(io::Error::other)?
        } else {
            EpochsFile::default()
        };
        Ok(Self { file: file.to_path_buf(), behind: false, floor, highest })
    }

    /// Highest epoch of `role` so far; a process that starts now uses a higher one. The next epoch
    /// counts as assigned.
    ///
    /// # Errors
    /// If there is no next one.
    pub fn give(&mut self, role: Participant) -> io::Result<u64> {
        let floor = self.highest(role);
        let next = floor.checked_add(1).ok_or_else(|| too_great(role, floor))?;
        self.keep(role, next)?;
        Ok(floor)
    }

    /// Records an epoch of `role`; its next process uses a higher one.
    ///
    /// # Errors
    /// If it has no next one.
    pub fn observe(&mut self, role: Participant, epoch: u64) -> io::Result<()> {
        if epoch > self.highest(role) { self.keep(role, epoch) } else { Ok(()) }
    }

    /// Highest epoch of `role`; the floor before the first.
    pub fn highest(&self, role: Participant) -> u64 {
        self.highest.get(role.text()).copied().unwrap_or(0).max(self.floor)
    }

    fn keep(&mut self, role: Participant, epoch: u64) -> io::Result<()> {
        if epoch > EPOCH_MAX {
            return Err(too_great(role, epoch));
        }
        self.highest.insert(role.text().to_owned(), epoch);
        let written = self.write();
        if let Err(error) = &written
            && !self.behind
        {
            tracing::error!(
                %error,
                file = %self.file.display(),
                "epochs cannot be kept on disk: \
                 the next launch in this folder does not know of them"
            );
        }
        self.behind = written.is_err();
        Ok(())
    }

    fn write(&self) -> io::Result<()> {
        let text = toml::to_string(&self.highest).map_err(io::Error::other)?;
        atomic_file::write(&self.file, text.as_bytes())
    }
}

fn too_great(role: Participant, epoch: u64) -> io::Error {
    io::Error::other(format!(
        "epoch {epoch} of the {role}: expected at most {EPOCH_MAX}, \
         above which there is no next one to be kept"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn every_start_gets_an_epoch_above_all_earlier_ones() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("epochs.toml");
        let mut epochs = Epochs::open(&file, 0)?;
        assert_eq!(epochs.give(Participant::Controller)?, 0);
        assert_eq!(
            epochs.give(Participant::Controller)?,
            1,
            "it may have died before its first message"
        );
        epochs.observe(Participant::Controller, 9)?;
        epochs.observe(Participant::Controller, 3)?;
        assert_eq!(epochs.give(Participant::Controller)?, 9);
        assert_eq!(epochs.give(Participant::Plant)?, 0, "roles do not share epochs");
        Ok(())
    }

    #[test]
    fn epochs_of_one_second_differ_and_those_of_a_later_second_are_greater() {
        let second = Duration::from_secs(1_795_250_000);
        let drawn: std::collections::BTreeSet<u64> =
            (0..50).map(|_| unused_epoch(second)).collect();
        assert!(drawn.len() > 45, "{drawn:?}");
        let later = unused_epoch(second + Duration::from_secs(1));
        assert!(drawn.iter().all(|&epoch| epoch < later && epoch < 1 << 53));
        assert_eq!(unused_epoch(Duration::MAX), EPOCH_MAX);
    }

    #[test]
    fn a_launch_uses_epochs_above_those_of_earlier_launches() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("epochs.toml");
        assert_eq!(Epochs::open(&file, 1_000)?.give(Participant::Plant)?, 1_000);
        assert_eq!(
            Epochs::open(&file, 500)?.give(Participant::Plant)?,
            1_001,
            "the clock has been set back"
        );
        Ok(())
    }

    #[test]
    fn an_epoch_without_a_successor_is_rejected_with_its_line() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("epochs.toml");
        fs::write(&file, "controller = 3\nplant = 9223372036854775807\n")?;
        let refused = Epochs::open(&file, 0).map(drop).map_err(|error| error.to_string());
        assert!(
            refused
                .is_err_and(|text| { text.contains("epochs.toml:2: plant = 9223372036854775807") })
        );
        Ok(())
    }

    #[test]
    fn no_epoch_exceeds_the_largest_and_none_is_assigned_twice() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("epochs.toml");
        let mut epochs = Epochs::open(&file, 0)?;
        let refused =
            epochs.observe(Participant::Controller, u64::MAX).map_err(|error| error.to_string());
        assert!(refused.is_err_and(|text| { text.contains("18446744073709551615") }));
        assert_eq!(epochs.give(Participant::Controller)?, 0, "what cannot be is not remembered");
        epochs.observe(Participant::Controller, EPOCH_MAX)?;
        assert!(epochs.give(Participant::Controller).is_err());
        assert_eq!(Epochs::open(&file, 0)?.highest(Participant::Controller), EPOCH_MAX);
        assert!(Epochs::open(&file, u64::MAX)?.give(Participant::Plant).is_err());
        Ok(())
    }

    #[test]
    fn a_full_disk_ends_no_run() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("run/epochs.toml");
        let mut epochs = Epochs::open(&file, 0)?;
        assert_eq!(epochs.give(Participant::Controller)?, 0);
        epochs.observe(Participant::Controller, 4)?;
        assert_eq!(epochs.give(Participant::Controller)?, 4, "known, if not kept");
        fs::create_dir(folder.path().join("run"))?;
        epochs.observe(Participant::Plant, 2)?;
        assert_eq!(
            Epochs::open(&file, 0)?.highest(Participant::Controller),
            5,
            "with the next one that can be kept all are"
        );
        Ok(())
    }

    #[test]
    fn epochs_outlive_the_launcher() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("epochs.toml");
        Epochs::open(&file, 0)?.observe(Participant::Plant, 4)?;
        assert_eq!(Epochs::open(&file, 0)?.highest(Participant::Plant), 4);
        assert_eq!(fs::read_dir(folder.path())?.count(), 1, "nothing half-written is left");
        Ok(())
    }
}
