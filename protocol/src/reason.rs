//! zenoh's errors, as far as they are of use to a person.

/// What went wrong. zenoh also says where in its sources.
pub(crate) fn first_line(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let text = text.lines().next().unwrap_or_default();
    text.split(" at /").next().unwrap_or(text).trim().to_owned()
}
