//! ResidualSample in, ModelSnapshot out: the Gaussian-process learner, in a process of its own.
//!
//! | module           | what it does                                                           |
//! |------------------|------------------------------------------------------------------------|
//! | [`settings`]     | settings of the learner process                                        |
//! | [`tunable`]      | changes of settings while the robot drives                             |
//! | [`data_set`]     | the samples that a fit learns from                                     |
//! | [`fit`]          | a data set in, hyperparameters and posterior out                       |
//! | [`held_out`]     | noise of a new sample, from held-out samples                           |
//! | [`snapshot`]     | scores a fitted model and writes its message                           |
//! | `fault_injector` | injects faults into the published snapshots, with the feature `faults` |
//! | [`store`]        | saves the last snapshot to a file and resumes from it                  |
//! | [`run`]          | the loop: receives samples while the fit runs beside it                |

pub mod data_set;
#[cfg(feature = "faults")]
pub mod fault_injector;
pub mod fit;
pub mod held_out;
pub mod run;
pub mod settings;
pub mod snapshot;
pub mod store;
pub mod tunable;

pub use settings::Settings;
