//! Settings: TOML in, checked types out.
//!
//! | module     | what it holds                                                          |
//! |------------|------------------------------------------------------------------------|
//! | `check`    | [`Check`]: whether the values of settings are possible                 |
//! | `read`     | file → text → table → type → checked type                              |
//! | [`change`] | settings in use + a few keys → settings                                |
//! | `explain`  | messages of serde → errors of this crate                               |
//! | `error`    | [`SettingsError`]: file, line, key, value, and the expected value      |
//! | `place`    | dotted key ↔ position in the document                                  |
//!
//! ```
//! use serde::Deserialize;
//! use settings::{Check, Impossible};
//! use std::path::Path;
//!
//! #[derive(Debug, Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct Load {
//!     mass_kg: f64,
//! }
//!
//! impl Check for Load {
//!     fn check(&self) -> Result<(), Impossible> {
//!         if self.mass_kg > 0.0 {
//!             return Ok(());
//!         }
//!         Err(Impossible::new("mass_kg", "a positive mass"))
//!     }
//! }
//!
//! let refused = settings::parse::<Load>("# a crate\nmass_kg = -3.0\n", Path::new("load.toml"));
//! let message = refused.map_err(|error| error.to_string()).err();
//! let expected = "load.toml:2: mass_kg = -3.0: expected a positive mass";
//! assert_eq!(message.as_deref(), Some(expected));
//! ```

pub mod change;
mod check;
mod error;
mod explain;
mod place;
mod read;

pub use check::{Check, Impossible};
pub use error::{SettingsError, WriteError};
pub use read::{parse, read, write};
