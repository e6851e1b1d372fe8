//! The common part of all fuzz targets: it passes the bytes to the decoder of its name, and panics
//! at a broken promise.

/// Passes `bytes` to the decoder named `name`.
///
/// # Panics
/// If the decoder breaks a promise: a panic is how the fuzzer learns of it.
pub fn judge(name: &str, bytes: &[u8]) {
    let decoder =
        promises::decoders::named(name).unwrap_or_else(|| panic!("there is no decoder {name}"));
    if let Err(broken) = decoder(bytes) {
        panic!("{name}: {broken}");
    }
}
