//! ResidualSample in, ModelSnapshot out: the Gaussian-process learner, in its own process and its own time.
//!
//! | module             | what it does                                                 |
//! |--------------------|--------------------------------------------------------------|
//! | [`settings`]       | what a person may set                                        |
//! | [`tunable`]        | what a person changes while the robot drives                 |
//! | [`fit`]            | a data set in, hyperparameters and posterior out             |
//! | [`held_out`]       | how far a new sample is off                                  |
//! | [`snapshot`]       | what was fitted, scored and put into a message               |
//! | [`fault_injector`] | bad snapshots on purpose                                     |
//! | [`store`]          | the last snapshot, kept in a file and resumed from it        |
//! | [`run`]            | the loop: samples keep arriving while the fit runs beside it |

pub mod fault_injector;
pub mod fit;
pub mod held_out;
pub mod run;
pub mod settings;
pub mod snapshot;
pub mod store;
pub mod tunable;

pub use settings::Settings;
