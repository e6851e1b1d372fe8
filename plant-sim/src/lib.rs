//! The simulated plant: a mecanum robot and its world, behind the same two topics as a real one.
//! The world is that of this crate ([`truth`]), or another program ([`driver::piped`]).
//!
//! | module       | what it does                                                              |
//! |--------------|---------------------------------------------------------------------------|
//! | [`truth`]    | the true world: dynamics, friction, disturbances, sensors. Pure           |
//! | [`settings`] | settings of the plant process                                             |
//! | `base`       | the world as a [`driver::Base`]                                           |
//!
//! The controller knows nothing of this crate.

mod base;
pub mod settings;
pub mod truth;

pub use settings::Settings;

use driver::RunError;
use driver::piped::PipedBase;
use process::Stop;
use transport::{Identity, Ports};
use truth::World;

/// Runs the world of `settings` until the end of the run, or until a stop is requested.
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
            PipedBase::start(program, settings.robot.wheels.count(), start, seed)?,
            &driver,
            ports,
            identity,
            stop,
        );
    }
    let truth = settings.truth.clone().unwrap_or_default();
    driver::run(World::new(&truth, start, seed), &driver, ports, identity, stop)
}
