//! Many independent runs, as many at a time as there are processors.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Instant;
use terminal::Terminal;

/// Runs `run` with the index of each of `items` and the item itself, shows the progress, and
/// returns the results in the order of the items. `each` gets every result in that order, as soon
/// as all before it are there. The first error ends the runs.
pub(crate) fn run_all<T: Sync, R: Send, E: Send>(
    items: &[T],
    terminal: &mut Terminal,
    what: &str,
    run: impl Fn(usize, &T) -> Result<R, E> + Sync,
    mut each: impl FnMut(&R) -> Result<(), E>,
) -> Result<Vec<R>, E> {
    let next = AtomicUsize::new(0);
    let workers = thread::available_parallelism().map_or(1, usize::from).min(items.len());
    let (sender, finished) = mpsc::channel();
    let mut done: BTreeMap<usize, R> = BTreeMap::new();
    let mut reported = 0;
    let begin = Instant::now();
    thread::scope(|scope| {
        for _ in 0..workers {
            let (next, sender, run) = (&next, sender.clone(), &run);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else { return };
                    if sender.send((index, run(index, item))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for (index, result) in finished {
            done.insert(index, result.inspect_err(|_| next.store(items.len(), Ordering::Relaxed))?);
            // In the order of the items, independent of their speed.
            while let Some(result) = done.get(&reported) {
                each(result)?;
                reported += 1;
            }
            let count = done.len();
            terminal.progress(Instant::now(), || {
                let spent = begin.elapsed().as_secs_f64();
                let left = spent / count as f64 * (items.len() - count) as f64;
                Some(format!(
                    "{what}: {count} of {}, {spent:.0} s, about {left:.0} s to go",
                    items.len()
                ))
            });
        }
        Ok(())
    })?;
    Ok(done.into_values().collect())
}
