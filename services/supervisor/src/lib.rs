//! Starts the processes of a graph, restarts those that fail, and ends all of them.
//!
//! | module                | contents                                                         |
//! |-----------------------|------------------------------------------------------------------|
//! | [`launch`]            | one run, from reading its files to removing its remains          |
//! | [`all_hosts`]         | a graph with several hosts on this machine                       |
//! | [`fleet`]             | all processes: start in order, restart, stop in order            |
//! | [`child`]             | one process: start, signal, exit status                          |
//! | `silence`             | detects missing heartbeats                                       |
//! | [`watch`]             | `Health` and `Plan` → state that the launcher uses               |
//! | [`processes_by_role`] | the present process of each role                                 |
//! | [`fault_injector`]    | injects faults into the processes, and records the times         |
//! | [`service_manager`]   | reports to the service manager that the loop runs                |
//! | [`progress`]          | the live line                                                    |
//! | [`closing`]           | `summary.json` → the table at the end                            |

pub mod all_hosts;
pub mod child;
pub mod closing;
#[cfg(feature = "faults")]
pub mod fault_injector;
pub mod fleet;
pub mod launch;
#[cfg(feature = "faults")]
mod memory_filler;
pub mod processes_by_role;
pub mod progress;
pub mod service_manager;
mod silence;
pub mod watch;
