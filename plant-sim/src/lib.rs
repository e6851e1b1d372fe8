//! The truth: a simulated mecanum robot and its world, behind the same two topics as a real one.
//! The world is our own ([`truth`]), or another program's ([`driver::piped`]).
//!
//! | module       | what it does                                                              |
//! |--------------|---------------------------------------------------------------------------|
//! | [`truth`]    | what is really the case: dynamics, friction, world, sensors. Pure         |
//! | [`settings`] | what a person may set                                                     |
//! | `base`       | the world as a [`driver::Base`]                                           |
//!
//! Nothing here is known to the controller.

mod base;
pub mod settings;
pub mod truth;

pub use settings::Settings;

use driver::RunError;
use driver::piped::PipedBase;
use process::Stop;
use protocol::port::{Identity, Ports};
use truth::World;

/// Drives the world that `settings` name until the end of the run, or until it is told to stop.
///
/// # Errors
/// [`RunError`].
pub fn run(
    settings: &Settings,
    ports: &Ports,
    identity: Identity,
    stop: &Stop,
) -> Result<(), RunError> {
    let (start, seed, driver) = (settings.start, settings.seed, settings.driver());
    if let Some(program) = &settings.program {
        return driver::run(
            PipedBase::start(program, start, seed)?,
            &driver,
            ports,
            identity,
            stop,
        );
    }
    let truth = settings.truth.clone().unwrap_or_default();
    driver::run(World::new(&truth, start, seed), &driver, ports, identity, stop)
}
