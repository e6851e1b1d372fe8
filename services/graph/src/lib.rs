//! The files of a graph, and from them the settings of each process.
//!
//! | module           | contents                                                          |
//! |------------------|-------------------------------------------------------------------|
//! | [`options`]      | options of the command line                                       |
//! | [`mod@file`]     | the graph file                                                    |
//! | [`hosts`]        | its hosts, and where they meet                                    |
//! | [`role`]         | the processes, and the order in which they start and stop         |
//! | [`back_off`]     | when to restart a process that has ended                          |
//! | [`scenario`]     | the scenario file                                                 |
//! | `map`            | the map file                                                      |
//! | `faults`         | the file of the faults to inject, with the feature `faults`       |
//! | [`exposure`]     | addresses of a graph that other machines on the network can reach |
//! | [`certificates`] | a directory of certificates → credentials of this host            |
//! | [`first_model`]  | the snapshot that a run begins with                               |
//! | [`assembly`]     | options + graph + scenario + robot → settings of each process     |

pub mod assembly;
pub mod back_off;
pub mod certificates;
pub mod exposure;
#[cfg(feature = "faults")]
pub mod faults;
pub mod file;
pub mod first_model;
pub mod hosts;
mod map;
pub mod options;
pub mod role;
pub mod scenario;
