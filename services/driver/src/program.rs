//! A process around a base, which a launch starts in place of the simulator.

use crate::{Base, BaseError, ProgramSettings};
use ::settings::Check;
use protocol::message::Participant;
use serde::de::DeserializeOwned;
use std::process::ExitCode;
use transport::{Identity, Ports};

/// `main` of a driver: reads the settings that the launch has written, opens the base with them,
/// and drives it until the end of the run. The graph file names the program in its table
/// `[driver]`.
///
/// ```no_run
/// use driver::{Base, BaseError, ProgramSettings, Sensors};
/// use serde::Deserialize;
/// use std::process::ExitCode;
///
/// /// `[driver.settings]` of the graph file.
/// #[derive(Deserialize)]
/// struct MySettings {
///     address: String,
/// }
///
/// impl settings::Check for MySettings {}
///
/// struct MyBase;
///
/// impl MyBase {
///     fn open(settings: &ProgramSettings<MySettings>) -> Result<Self, BaseError> {
///         Ok(Self)
///     }
/// }
///
/// impl Base for MyBase {
///     fn read(&mut self) -> Result<Sensors, BaseError> {
///         Ok(Sensors::default())
///     }
///
///     fn drive(&mut self, velocity: [f64; 3], nanos: u64) -> Result<(), BaseError> {
///         Ok(())
///     }
/// }
///
/// fn main() -> ExitCode {
///     driver::main(MyBase::open)
/// }
/// ```
pub fn main<S, B>(open: impl FnOnce(&ProgramSettings<S>) -> Result<B, BaseError>) -> ExitCode
where
    S: DeserializeOwned + Check,
    B: Base,
{
    process::main::<ProgramSettings<S>>(Participant::Plant, |settings, stop| {
        let run = &settings.run;
        // Before the ports: a base that waits for its hardware leaves the graph alone.
        let base = open(&settings)?;
        run.go_first_to_open();
        let identity = Identity::new(run.epoch_floor + 1);
        let ports = Ports::open(&run.links, identity)?;
        let surroundings = settings.surroundings()?;
        let driver = settings.driver(Some(&surroundings));
        crate::run(base, &driver, &ports, identity, stop)?;
        Ok(())
    })
}
