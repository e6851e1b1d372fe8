//! What a person may set: TOML in, checked types out.
//!
//! | module    | what it holds                                                           |
//! |-----------|-------------------------------------------------------------------------|
//! | `check`   | [`Check`]: whether settings that read well are possible too             |
//! | `read`    | file → text → table → type → checked type                               |
//! | [`change`] | settings in use + a few keys → settings                                |
//! | `explain` | what serde says of a document, as one of our errors                     |
//! | `error`   | [`SettingsError`]: file, line, key, value, and what was expected        |
//! | `place`   | dotted key ↔ place in the document                                      |
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
//!         if self.mass_kg > 0.0 { Ok(()) } else { Err(Impossible::new("mass_kg", "a positive mass")) }
//!     }
//! }
//!
//! let refused = settings::parse::<Load>("# of the crate\nmass_kg = -3.0\n", Path::new("load.toml"));
//! let told = refused.map_err(|error| error.to_string());
//! assert_eq!(told.err().as_deref(), Some("load.toml:2: mass_kg = -3.0: expected a positive mass"));
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
