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
//! | [`reached`]    | accelerations that were reached                                       |
//! | [`numbers`]    | all numbers with their names                                          |
//! | [`judgement`]  | prediction of held-out motion, and what the data do not tell          |
//! | [`robot_file`] | the result as a robot file                                            |
//! | [`tuned`]      | period, horizon and weights that fit it                               |
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
pub mod numbers;
pub mod parameter;
pub mod reached;
pub mod report;
pub mod response;
pub mod robot_file;
pub mod sensors;
mod start;
pub mod tuned;
