//! The run directory: settings, logs, record, summary.

use crate::private::{self, NotPrivate};
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use std::{fs, io};

/// Default parent of run directories.
const RUNS: &str = "runs";

/// Why a run directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// It is not empty, and would contain two runs.
    #[error("--out {}: expected a new or empty folder", folder.display())]
    NotEmpty {
        /// The directory.
        folder: PathBuf,
    },
    /// Other users could read or change its contents.
    #[error("{0}; or name another folder with --out")]
    NotPrivate(#[from] NotPrivate),
    /// It cannot be created.
    #[error("the folder {} cannot be made: {source}", folder.display())]
    Unusable {
        /// The directory.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Creates the run directory and returns its absolute path. `out` must be new, or empty and private
/// to this user. Without `out` the name contains time, scenario and graph. No other user can enter
/// it.
///
/// # Errors
/// [`FolderError`].
pub fn create(out: Option<&Path>, scenario: &str, id: &str) -> Result<PathBuf, FolderError> {
    let folder = out.map_or_else(
        || Path::new(RUNS).join(format!("{}-{scenario}-{id}", utc(SystemTime::now()))),
        Path::to_path_buf,
    );
    let unusable = |source| FolderError::Unusable { folder: folder.clone(), source };
    check(&folder)?;
    private::make(&folder)?;
    // Two launches that start at the same time both find the directory empty. Only one creates
    // this.
    fs::create_dir(folder.join("settings")).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => FolderError::NotEmpty { folder: folder.clone() },
        _ => unusable(source),
    })?;
    folder.canonicalize().map_err(unusable)
}

/// Checks that a run may use `folder`. Creates nothing.
///
/// # Errors
/// [`FolderError`] if it exists and is not empty, or not private to this user.
pub fn check(folder: &Path) -> Result<(), FolderError> {
    if fs::symlink_metadata(folder).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
        return Ok(());
    }
    private::check(folder)?;
    match fs::read_dir(folder).map(|mut entries| entries.next()) {
        Ok(None) => Ok(()),
        Ok(Some(_)) => Err(FolderError::NotEmpty { folder: folder.to_path_buf() }),
        Err(source) => Err(FolderError::Unusable { folder: folder.to_path_buf(), source }),
    }
}

/// A time as in `20261121T083303Z`, which sorts.
pub(crate) fn utc(time: SystemTime) -> String {
    let seconds = time.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (year, month, day) = civil_date(seconds / 86_400);
    let of_day = seconds % 86_400;
    format!(
        "{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z",
        of_day / 3600,
        of_day / 60 % 60,
        of_day % 60
    )
}

/// Year, month and day of the Gregorian calendar, `days` days after 1970-01-01.
///
/// Reference: Hinnant, *chrono-compatible low-level date algorithms*, `civil_from_days`: years
/// begin in March, so that the leap day is last.
fn civil_date(days: u64) -> (u64, u64, u64) {
    let since_0000_03 = days + 719_468;
    let era = since_0000_03 / 146_097;
    let day_of_era = since_0000_03 % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_time_is_formatted_by_the_gregorian_calendar() {
        let at = |seconds| utc(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(0), "19700101T000000Z");
        assert_eq!(at(951_782_399), "20000228T235959Z");
        assert_eq!(at(951_782_400), "20000229T000000Z");
        assert_eq!(at(1_795_250_000), "20261121T083320Z");
    }

    #[test]
    fn only_one_of_several_simultaneous_runs_gets_the_directory()
    -> Result<(), Box<dyn std::error::Error>> {
        for _ in 0..20 {
            let parent = tempfile::tempdir()?;
            let (out, start) = (parent.path().join("run"), std::sync::Barrier::new(8));
            let begin = || {
                start.wait();
                create(Some(&out), "paper", "a").is_ok()
            };
            let got = std::thread::scope(|scope| {
                let beginners: Vec<_> = (0..8).map(|_| scope.spawn(begin)).collect();
                beginners
                    .into_iter()
                    .filter_map(|beginner| beginner.join().ok())
                    .filter(|&got| got)
                    .count()
            });
            assert_eq!(got, 1);
        }
        Ok(())
    }

    #[test]
    fn two_runs_never_share_a_folder() -> Result<(), Box<dyn std::error::Error>> {
        let parent = tempfile::tempdir()?;
        let out = parent.path().join("deep/run");
        let folder = create(Some(&out), "paper", "a")?;
        assert!(folder.join("settings").is_dir());
        let refused = create(Some(&out), "paper", "b").map_err(|error| error.to_string());
        assert_eq!(
            refused,
            Err(format!("--out {}: expected a new or empty folder", out.display()))
        );
        Ok(())
    }
}
