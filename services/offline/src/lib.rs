//! Trains models from logs: `coxswain learn`; and draws them: `coxswain model show`.
//!
//! | module             | contents                                                          |
//! |--------------------|-------------------------------------------------------------------|
//! | [`command`]        | `coxswain learn`: options, and the order of all this              |
//! | [`work`]           | periods → snapshot that is better than none                       |
//! | [`periods`]        | log → periods with their residuals, as the controller forms them  |
//! | [`training`]       | periods → fitted model, with the data set and fit of the learner  |
//! | [`prior`]          | the data of another robot file's snapshot, carried over           |
//! | [`contender`]      | the models that are compared                                      |
//! | [`cross_validation`] | errors on periods that a model was not trained on               |
//! | [`verdict`]        | whether the learned model may be used                             |
//! | [`show`]           | `coxswain model show`: a snapshot as a table                      |
//! | [`slices`]         | the learned residual over each input, with its uncertainty        |
//! | [`page`]           | the same as a page                                                |

pub mod command;
pub mod contender;
pub mod cross_validation;
pub mod page;
pub mod periods;
pub mod prior;
pub mod show;
pub mod slices;
pub mod training;
pub mod verdict;
pub mod work;
