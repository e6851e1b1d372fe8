//! events → open pages: each has a short queue of its own, and no page delays another.

use std::collections::VecDeque;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Largest number of viewers.
pub(super) const VIEWERS_MAX: usize = 16;
/// Largest number of queued events of one viewer: some seconds of them.
const EVENTS_MAX: usize = 64;

/// All open pages.
#[derive(Debug, Default)]
pub(super) struct Viewers {
    present: Mutex<Present>,
}

#[derive(Debug, Default)]
struct Present {
    viewers: Vec<Arc<Viewer>>,
    /// No new page is accepted.
    closed: bool,
}

/// One open page.
#[derive(Debug)]
pub(super) struct Viewer {
    queue: Mutex<Queue>,
    bell: Condvar,
    /// To interrupt a write that blocks.
    stream: TcpStream,
}

#[derive(Debug)]
struct Queue {
    events: VecDeque<Arc<str>>,
    /// The page is new or has fallen behind, and must receive the present state.
    unaware: bool,
    /// The page receives no more events.
    gone: bool,
}

impl Viewers {
    /// Adds a page; `None` if all places are taken.
    pub(super) fn join(&self, stream: TcpStream) -> Option<Arc<Viewer>> {
        let mut present = lock(&self.present);
        if present.closed || present.viewers.len() >= VIEWERS_MAX {
            return None;
        }
        let queue = Queue { events: VecDeque::new(), unaware: true, gone: false };
        let viewer = Arc::new(Viewer { queue: Mutex::new(queue), bell: Condvar::new(), stream });
        present.viewers.push(Arc::clone(&viewer));
        Some(viewer)
    }

    /// Frees the place of a page.
    pub(super) fn leave(&self, viewer: &Arc<Viewer>) {
        lock(&self.present).viewers.retain(|other| !Arc::ptr_eq(other, viewer));
    }

    /// Whether no page is open.
    pub(super) fn is_empty(&self) -> bool {
        lock(&self.present).viewers.is_empty()
    }

    /// Sends `news` to all pages. A page that is new or has fallen behind receives the present
    /// state instead. Never waits.
    pub(super) fn tell(&self, news: Option<&Arc<str>>, mut greeting: impl FnMut() -> Arc<str>) {
        let mut greeting_event: Option<Arc<str>> = None;
        for viewer in &lock(&self.present).viewers {
            let mut queue = lock(&viewer.queue);
            if queue.unaware {
                queue.unaware = false;
                queue
                    .events
                    .push_back(Arc::clone(greeting_event.get_or_insert_with(&mut greeting)));
            } else if let Some(news) = news {
                if queue.events.len() >= EVENTS_MAX {
                    // The missed events are contained in the next greeting.
                    queue.events.clear();
                    queue.unaware = true;
                } else {
                    queue.events.push_back(Arc::clone(news));
                }
            }
            viewer.bell.notify_one();
        }
    }

    /// Disconnects all pages, permanently.
    pub(super) fn close(&self) {
        let mut present = lock(&self.present);
        present.closed = true;
        for viewer in &present.viewers {
            lock(&viewer.queue).gone = true;
            viewer.bell.notify_one();
            // An error means that the page has already disconnected.
            let _ = viewer.stream.shutdown(Shutdown::Both);
        }
    }
}

impl Viewer {
    /// The next event, as soon as there is one; `None` at the end.
    pub(super) fn next(&self) -> Option<Arc<str>> {
        let mut queue = lock(&self.queue);
        loop {
            if queue.gone {
                return None;
            }
            if let Some(event) = queue.events.pop_front() {
                return Some(event);
            }
            queue = self.bell.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// Every change leaves the value consistent, so a panic of its holder does not matter.
fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;
    use std::net::TcpListener;

    fn stream(listener: &TcpListener) -> std::io::Result<TcpStream> {
        TcpStream::connect(listener.local_addr()?)
    }

    #[test]
    fn a_viewer_that_falls_behind_receives_the_present_state_and_delays_no_other()
    -> Result<(), Box<dyn Error>> {
        let (listener, viewers) = (TcpListener::bind("127.0.0.1:0")?, Viewers::default());
        let slow = viewers.join(stream(&listener)?).ok_or("no place")?;
        let mut greetings = 0;
        for number in 0..10 * EVENTS_MAX {
            viewers.tell(Some(&format!("{number}").into()), || {
                greetings += 1;
                format!("greeting {greetings}").into()
            });
            assert!(lock(&slow.queue).events.len() <= EVENTS_MAX, "a queue without end");
        }
        let first = slow.next().ok_or("nothing")?;
        assert!(first.starts_with("greeting") && greetings > 1, "{first} of {greetings}");
        assert!(
            slow.next().is_none_or(|second| second
                .parse::<usize>()
                .is_ok_and(|number| number > 9 * EVENTS_MAX - 10)),
            "old news"
        );
        Ok(())
    }

    #[test]
    fn one_viewer_too_many_is_refused_until_one_leaves() -> Result<(), Box<dyn Error>> {
        let (listener, viewers) = (TcpListener::bind("127.0.0.1:0")?, Viewers::default());
        let present: Vec<_> = (0..VIEWERS_MAX)
            .map(|_| Ok::<_, Box<dyn Error>>(viewers.join(stream(&listener)?)))
            .collect::<Result<_, _>>()?;
        assert!(present.iter().all(Option::is_some) && viewers.join(stream(&listener)?).is_none());
        if let Some(Some(first)) = present.first() {
            viewers.leave(first);
        }
        assert!(viewers.join(stream(&listener)?).is_some());
        Ok(())
    }
}
