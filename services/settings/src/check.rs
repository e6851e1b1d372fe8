//! Whether the values of settings are possible.

/// Settings whose values can be checked.
pub trait Check {
    /// Checks the values. By default, all values of the type are possible.
    ///
    /// # Errors
    /// [`Impossible`] names the first impossible setting.
    fn check(&self) -> Result<(), Impossible> {
        Ok(())
    }

    /// Keys of earlier versions, each with what has replaced it. An error names it.
    fn replaced() -> &'static [(&'static str, &'static str)] {
        &[]
    }
}

/// An impossible setting.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: expected {expected}")]
pub struct Impossible {
    /// Dotted path of the key, such as `truth.push.force_n` or, for an element of a list,
    /// `truth.motor_gain.2`.
    pub key: String,
    /// Expected value.
    pub expected: String,
}

impl Impossible {
    /// The error for a `key` whose value is not `expected`.
    pub fn new(key: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { key: key.into(), expected: expected.into() }
    }

    /// The same error, with the path prefixed by `table`.
    #[must_use]
    pub fn under(mut self, table: &str) -> Self {
        self.key.insert(0, '.');
        self.key.insert_str(0, table);
        self
    }
}
