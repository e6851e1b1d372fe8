//! events → open pages: each has a short queue of its own, and nobody waits for anybody.

use std::collections::VecDeque;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Most viewers at a time.
pub(super) const VIEWERS_MAX: usize = 16;
/// Most events that wait for one viewer: some seconds of them.
const EVENTS_MAX: usize = 64;

/// Everybody who looks on.
#[derive(Debug, Default)]
pub(super) struct Viewers {
    present: Mutex<Present>,
}

#[derive(Debug, Default)]
struct Present {
    viewers: Vec<Arc<Viewer>>,
    /// Nobody is let in any more.
    closed: bool,
}

/// One open page.
#[derive(Debug)]
pub(super) struct Viewer {
    queue: Mutex<Queue>,
    bell: Condvar,
    /// To end a write that hangs.
    stream: TcpStream,
}

#[derive(Debug)]
struct Queue {
    events: VecDeque<Arc<str>>,
    /// Has not been told how things stand, or has fallen behind: is to be greeted.
    unaware: bool,
    /// No more events come.
    gone: bool,
}

impl Viewers {
    /// A place for one more; none if all are taken.
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

    /// Its place is free again.
    pub(super) fn leave(&self, viewer: &Arc<Viewer>) {
        lock(&self.present).viewers.retain(|other| !Arc::ptr_eq(other, viewer));
    }

    /// Whether nobody looks on.
    pub(super) fn is_empty(&self) -> bool {
        lock(&self.present).viewers.is_empty()
    }

    /// Tells `news` to everybody, and to whoever has just come or has fallen behind how things stand instead. Waits for nobody.
    pub(super) fn tell(&self, news: Option<&Arc<str>>, mut greeting: impl FnMut() -> Arc<str>) {
        let mut greeting_said: Option<Arc<str>> = None;
        for viewer in &lock(&self.present).viewers {
            let mut queue = lock(&viewer.queue);
            if queue.unaware {
                queue.unaware = false;
                queue.events.push_back(Arc::clone(greeting_said.get_or_insert_with(&mut greeting)));
            } else if let Some(news) = news {
                if queue.events.len() >= EVENTS_MAX {
                    // What it has missed is in the next greeting.
                    queue.events.clear();
                    queue.unaware = true;
                } else {
                    queue.events.push_back(Arc::clone(news));
                }
            }
            viewer.bell.notify_one();
        }
    }

    /// Sends everybody away, for good.
    pub(super) fn close(&self) {
        let mut present = lock(&self.present);
        present.closed = true;
        for viewer in &present.viewers {
            lock(&viewer.queue).gone = true;
            viewer.bell.notify_one();
            // One that is gone already is as well.
            let _ = viewer.stream.shutdown(Shutdown::Both);
        }
    }
}

impl Viewer {
    /// The next event, as soon as there is one; nothing at the end.
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

/// Each change leaves the value whole: a panic of its holder does not matter.
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
    fn who_falls_behind_is_told_how_things_stand_and_holds_nobody_up() -> Result<(), Box<dyn Error>>
    {
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
    fn one_more_than_there_are_places_is_not_let_in_until_one_leaves() -> Result<(), Box<dyn Error>>
    {
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
