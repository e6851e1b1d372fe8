//! The simulated plant: a mecanum robot and its world, behind the same two topics as a real one.
//! The world is that of this crate ([`truth`]), or another program ([`driver::piped`]).
//!
//! | module       | what it does                                                              |
//! |--------------|---------------------------------------------------------------------------|
//! | [`truth`]    | the true world: dynamics, friction, disturbances, sensors. Pure           |
//! | [`settings`] | settings of the plant process                                             |
//! | [`obstacles`] | obstacles that stand or move                                             |
//! | `base`       | the world as a [`driver::Base`]                                           |
//!
//! The controller knows nothing of this crate.

mod base;
pub mod obstacles;
pub mod settings;
pub mod truth;

pub use settings::Settings;

use driver::piped::PipedBase;
use driver::{Base, RunError};
use obstacles::{Among, Crowd};
use process::{Pace, Stop};
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
    let (start, seed) = (settings.start, settings.seed);
    let drive = Drive { settings, ports, identity, stop };
    if let Some(program) = &settings.program {
        return drive.run(PipedBase::start(program, settings.robot.wheels.count(), start, seed)?);
    }
    let truth = settings.truth.clone().unwrap_or_default();
    drive.run(World::new(&truth, start, seed))
}

/// What a world needs beside itself.
struct Drive<'a> {
    settings: &'a Settings,
    ports: &'a Ports,
    identity: Identity,
    stop: &'a Stop,
}

impl Drive<'_> {
    /// Drives `base`, among obstacles if the world has some.
    fn run(self, base: impl Base) -> Result<(), RunError> {
        let Self { settings, ports, identity, stop } = self;
        // The settings have been checked: impossible maps and crowds have been refused.
        let known = driver::surroundings(settings.map.as_ref()).ok();
        // A planner can send lists in real time.
        let has_any = settings.run.pace == Pace::RealTime
            || settings.map.is_some()
            || settings.sees_obstacles();
        let driver = settings.driver(known.as_ref().filter(|_| has_any));
        let crowd = settings.obstacles.as_ref().and_then(|obstacles| obstacles.crowd().ok());
        match crowd.or_else(|| settings.sees_obstacles().then(Crowd::default)) {
            Some(crowd) => driver::run(Among::new(base, crowd), &driver, ports, identity, stop),
            None => driver::run(base, &driver, ports, identity, stop),
        }
    }
}
