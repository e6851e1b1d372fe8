//! iceoryx2 alone: as many bytes, in place, with events, and nothing else.

use super::ends::{End, sweep};
use super::{Failure, LONG};
use criterion::Criterion;
use std::path::Path;
use std::sync::mpsc;
use std::thread;

/// Ends the echo.
const LAST: u64 = u64::MAX;

/// Messages of `words` words; at most `depth` of them wait.
pub(crate) fn measure(
    criterion: &mut Criterion,
    folder: &Path,
    name: &str,
    words: usize,
    depth: usize,
) -> Result<(), Failure> {
    let (folder, prefix) =
        (folder.join(format!("bare-{name}")), format!("bare{}.", std::process::id()));
    let open = |directions| End::open(&folder, &prefix, directions, words, depth);
    let receive = |end: &End| end.receive(LONG)?.ok_or_else(|| Failure::from("nobody answers"));
    thread::scope(|scope| -> Result<(), Failure> {
        let (ready, is_ready) = mpsc::channel();
        let echo = scope.spawn(move || -> Result<(), Failure> {
            let end = open(["there", "back"])?;
            ready.send(())?;
            loop {
                let number = receive(&end)?;
                end.say(number)?;
                if number == LAST {
                    return Ok(());
                }
            }
        });
        let end = open(["back", "there"])?;
        is_ready.recv()?;
        let mut number = 0;
        let mut failure = None;
        criterion.bench_function(&format!("round trip/iceoryx2 alone, {name}"), |bencher| {
            bencher.iter(|| {
                number += 1;
                match end.say(number).and_then(|()| receive(&end)) {
                    Ok(answer) if answer == number => {}
                    Ok(_) => failure = Some("another number came back".into()),
                    Err(error) => failure = Some(error),
                }
            });
        });
        end.say(LAST)?;
        receive(&end)?;
        echo.join().map_err(|_| "the echo panicked")??;
        failure.map_or(Ok(()), Err)
    })?;
    sweep(&prefix);
    Ok(())
}
