//! page → gate: the stop button, for a browser on the robot's own machine.
//!
//! ```text
//! POST /stop, with the token ─▶ RUN/set/plant-000001.json ─▶ plant
//!            status and text ◀─ RUN/set/plant-000001.answer.json ◀┘
//! ```
//! A press takes the same way as `coxswain stop`. It is the only request to the page that acts.

use gate::Order;
use process::requests::{AskError, Asked, Outcome, Request, ask};
use protocol::message::Participant;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use subtle::ConstantTimeEq;

/// Longest time until the reply of the plant, as for `coxswain stop`.
const PATIENCE: Duration = Duration::from_secs(15);
/// Name in the record in place of a person's.
const WHO: &str = "page";

/// The stop button of one page.
#[derive(Debug)]
pub(super) struct StopButton {
    /// A request to stop must contain it.
    token: String,
    /// Run directory.
    folder: PathBuf,
    /// The last request.
    last: Mutex<Option<Asked>>,
}

/// Why the robot may not have stopped.
#[derive(Debug, thiserror::Error)]
pub(super) enum StopError {
    /// The request could not be written.
    #[error("the request to stop cannot be written: {0}")]
    Ask(#[from] AskError),
    /// The plant rejected the order.
    #[error("rejected by the plant: {reason}")]
    Rejected {
        /// Why.
        reason: String,
    },
    /// The plant sent no reply in time.
    #[error("the plant has not replied for {PATIENCE:?}; it stops the robot when it is back")]
    NoAnswer,
}

impl StopError {
    /// Status line without the version.
    pub(super) fn status(&self) -> &'static str {
        match self {
            Self::Ask(_) => "500 Internal Server Error",
            Self::Rejected { .. } => "409 Conflict",
            Self::NoAnswer => "504 Gateway Timeout",
        }
    }
}

impl StopButton {
    /// A button with a new token, for the run in `folder`.
    pub(super) fn new(folder: &Path) -> io::Result<Self> {
        let draw = || getrandom::u64().map_err(io::Error::other);
        let token = format!("{:016x}{:016x}", draw()?, draw()?);
        Ok(Self { token, folder: folder.to_owned(), last: Mutex::default() })
    }

    /// 128 unpredictable bits, in hexadecimal.
    pub(super) fn token(&self) -> &str {
        &self.token
    }

    /// Whether `token` is that of this button. The time does not depend on the first difference.
    pub(super) fn opens_with(&self, token: &str) -> bool {
        self.token.as_bytes().ct_eq(token.as_bytes()).into()
    }

    /// Requests a stop and waits for the reply, as long as it `may` come. Returns the tick from
    /// which on the gate is stopped.
    pub(super) fn press(&self, may: impl FnMut() -> bool) -> Result<u64, StopError> {
        let settled = self.request()?.wait(PATIENCE, may).ok_or(StopError::NoAnswer)?;
        match settled.answer.outcome {
            Outcome::Applied { acts_from_tick, .. } => Ok(acts_from_tick),
            Outcome::Refused { reason, .. } => Err(StopError::Rejected { reason }),
        }
    }

    /// A new request, or the last one while it has no reply. So many presses cannot fill the disk
    /// while the plant does not reply.
    fn request(&self) -> Result<Asked, AskError> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(waiting) = last.as_ref().filter(|asked| asked.answer().is_none()) {
            return Ok(waiting.clone());
        }
        let request = Request::new(WHO, Order::Stop.name());
        Ok(last.insert(ask(&self.folder, Participant::Plant, &request)?).clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use process::requests::welcome;
    use std::error::Error;
    use std::fs;

    #[test]
    fn every_button_has_a_token_of_its_own_and_accepts_no_other() -> io::Result<()> {
        let [one, other] = [StopButton::new(Path::new(""))?, StopButton::new(Path::new(""))?];
        assert_eq!(one.token().len(), 32);
        assert!(one.opens_with(one.token()) && !one.opens_with(other.token()));
        for wrong in ["", "0", &one.token()[..31], &format!("{}0", one.token())] {
            assert!(!one.opens_with(wrong), "{wrong:?}");
        }
        Ok(())
    }

    #[test]
    fn presses_share_one_request_until_the_plant_replies() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let button = StopButton::new(folder.path())?;
        let [first, second] = [button.request()?, button.request()?];
        assert_eq!((first.number, second.number), (1, 1));
        let reply = r#"{"user": 0, "answered_nanos": 0, "outcome": "refused", "reason": "x"}"#;
        fs::write(folder.path().join("set/plant-000001.answer.json"), reply)?;
        assert_eq!(button.request()?.number, 2);
        Ok(())
    }

    #[test]
    fn without_a_run_or_a_reply_a_press_fails() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let button = StopButton::new(folder.path())?;
        assert!(matches!(button.press(|| false), Err(StopError::Ask(_))));
        welcome(folder.path())?;
        assert!(matches!(button.press(|| false), Err(StopError::NoAnswer)));
        Ok(())
    }
}
