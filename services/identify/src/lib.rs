//! Identifies a robot from what it did: `coxswain identify`.
//!
//! | module         | contents                                                              |
//! |----------------|-----------------------------------------------------------------------|
//! | [`log`]        | records, tables and bags → samples                                    |
//! | [`response`]   | the response that is identified, and its simulation                   |
//! | [`parameter`]  | its numbers as a vector                                               |
//! | `start`        | where a fit starts                                                    |
//! | [`fit`]        | the estimate, with intervals                                          |
//! | [`sensors`]    | noise, latency, wheels                                                |
//! | [`judgement`]  | prediction of held-out motion, and what the data do not tell          |
//! | [`robot_file`] | the result as a robot file                                            |
//! | [`report`]     | the result as a page                                                  |
//! | [`excitation`] | a motion that tells the parameters apart                              |
//! | [`drive`]      | a launch that drives it                                               |
//! | [`command`]    | options, and the order of all this                                    |

pub mod command;
pub mod drive;
pub mod excitation;
pub mod fit;
pub mod judgement;
pub mod log;
pub mod parameter;
pub mod report;
pub mod response;
pub mod robot_file;
pub mod sensors;
mod start;
