//! `coxswain arm` and `coxswain resume`: a person's order to the plant of a run that drives.
//!
//! The order goes the way of a change of settings ([`crate::set`]): a file in the folder of the run,
//! which the plant answers beside it.

use crate::set::{SetError, set};
use crate::terminal;
use clap::Args;
use gate::Order;
use process::requests::Outcome;
use protocol::message::Participant;
use std::path::{Path, PathBuf};

/// Which run.
#[derive(Debug, Clone, Args)]
pub struct OrderOptions {
    /// The folder of the run; by default that of the launch that runs on this machine.
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
}

/// Gives `order` to the plant of the launch that `options` name, with the graphs of this machine in
/// `base`, and prints from which tick on it acts.
///
/// # Errors
/// [`SetError`]; the gate is as it was then.
pub fn run(order: Order, options: &OrderOptions, base: &Path) -> Result<(), SetError> {
    let settled = set(options.run.as_deref(), base, Participant::Plant, order.name())?;
    if let Outcome::Applied { acts_from_tick, .. } = settled.answer.outcome {
        terminal::print(format_args!(
            "{}: the gate is armed from tick {acts_from_tick} on",
            order.name()
        ));
    }
    Ok(())
}
