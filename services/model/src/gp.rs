//! Gaussian-process regression of the error of the main model: three outputs over shared inputs,
//! each with its own kernel.
//!
//! ```text
//! samples ─ normalisation ─▶ fit (likelihood, optimise) ─ hyperparameters ─▶ posterior
//! posterior ─▶ mean, gradient, variance
//! ```
//!
//! The modules below [`normalisation`] take normalised inputs. Everything is deterministic: budgets
//! count evaluations, seeds are explicit, and sums have a fixed order.
//!
//! Reference: Rasmussen & Williams, *Gaussian Processes for Machine Learning*, 2006, ch. 2 and 5.
//!
//! ```
//! use model::gp::fit::{FitOptions, fit};
//! use model::gp::hyperparameters::Hyperparameters;
//! use model::gp::posterior::Posterior;
//!
//! let inputs: Vec<[f64; 1]> = (0..20).map(|i| [f64::from(i) / 4.0]).collect();
//! let targets: Vec<[f64; 3]> =
//!     inputs.iter().map(|x| [x[0].sin(), x[0].cos(), 0.1 * x[0]]).collect();
//!
//! let start = Hyperparameters::new([1.0], 1.0, 1e-2);
//! let mut hyperparameters = [start; 3];
//! for (output, hyperparameters) in hyperparameters.iter_mut().enumerate() {
//!     let of_one: Vec<f64> = targets.iter().map(|y| y[output]).collect();
//!     *hyperparameters = fit(&inputs, &of_one, &start, &FitOptions::default())?.hyperparameters;
//! }
//! let posterior = Posterior::new(&inputs, &targets, &hyperparameters)?;
//! assert!((posterior.mean(&[2.1])[0] - 2.1_f64.sin()).abs() < 1e-2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod covariance;
pub mod data;
pub mod dictionary;
mod exponential;
pub mod fit;
pub mod hyperparameters;
mod inverse;
pub mod kernel;
pub mod likelihood;
mod line_search;
pub mod normalisation;
pub mod optimise;
pub mod posterior;
pub mod split_mix;
mod surprise;
mod vectorise;
