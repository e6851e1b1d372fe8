//! What every fuzz target does: it gives the bytes to the decoder of its name, and stops at a broken promise.

/// Gives `bytes` to the decoder that is called `name`.
///
/// # Panics
/// If the decoder breaks a promise, which is how a fuzzer is told.
pub fn judge(name: &str, bytes: &[u8]) {
    let decoder = promises::decoders::named(name).unwrap_or_else(|| panic!("there is no decoder {name}"));
    if let Err(broken) = decoder(bytes) {
        panic!("{name}: {broken}");
    }
}
