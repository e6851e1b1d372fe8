//! Whether settings that read well are possible too.

/// Settings that can be judged.
pub trait Check {
    /// Whether there can be such a thing. Everything that reads is possible unless a type says otherwise.
    ///
    /// # Errors
    /// [`Impossible`] names the first setting that cannot be.
    fn check(&self) -> Result<(), Impossible> {
        Ok(())
    }
}

/// A setting that cannot be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: expected {expected}")]
pub struct Impossible {
    /// Dotted path of the key, such as `truth.push.force_n` or, for an element of a list, `truth.motor_gain.2`.
    pub key: String,
    /// What it would have to be.
    pub expected: String,
}

impl Impossible {
    /// `key` would have to be `expected`.
    pub fn new(key: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { key: key.into(), expected: expected.into() }
    }

    /// The same, seen from the table that `table` is in.
    #[must_use]
    pub fn under(mut self, table: &str) -> Self {
        self.key.insert(0, '.');
        self.key.insert_str(0, table);
        self
    }
}
