//! `coxswain arm`, `resume` and `stop`: an operator's order to the plant of a run.
//!
//! The order takes the same way as a change of settings ([`crate::set`]): a file in the run
//! directory, to which the plant replies beside it.

use crate::set::{Recipient, SetError};
use clap::Args;
use gate::Order;
use process::requests::Outcome;
use protocol::message::{GateState, Participant};
use std::path::Path;

/// Whom to order.
#[derive(Debug, Clone, Args)]
pub struct OrderOptions {
    #[command(flatten)]
    to: Recipient,
}

/// Gives `order` to the plant of the launch that `options` name, with the graphs of this machine in
/// `base`, and prints the tick at which it takes effect.
///
/// # Errors
/// [`SetError`]; the state of the gate is then unchanged.
pub fn run(order: Order, options: &OrderOptions, base: &Path) -> Result<(), SetError> {
    let settled = options.to.send(base, Participant::Plant, order.name())?;
    if let Outcome::Applied { acts_from_tick, .. } = settled.answer.outcome {
        let state = if order == Order::Stop { GateState::Stopped } else { GateState::Armed };
        terminal::print(format_args!(
            "{}: the gate is {state} from tick {acts_from_tick} on",
            order.name()
        ));
    }
    Ok(())
}
