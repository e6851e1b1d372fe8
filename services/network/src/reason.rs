//! zenoh's errors, reduced to the part that helps a person.

/// The error alone. zenoh also reports the place in its sources.
pub fn first_line(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let text = text.lines().next().unwrap_or_default();
    text.split(" at /").next().unwrap_or(text).trim().to_owned()
}
