//! One writer on the network: a bounded queue, and the thread that empties it into zenoh.

use super::keys::Keys;
use super::line::{Declared, Held, Line};
use super::pieces::{Label, PIECE_BYTES_MAX, PIECES_AT_ONCE, pieces};
use super::presence::{self, Own, Presence, Role, check, draw_id, list};
use super::readers::{Newcomer, Readers};
use super::{Network, failed, no_thread};
use crate::carrier::{Encoding, Outlet};
use crate::{OpenError, Reservation, SendError};
use crossbeam_queue::ArrayQueue;
use protocol::topic::{Delivery, Quality, Topic};
use std::cell::Cell;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

/// How long a writer that is closed may take to send what waits.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);

/// Pause between two snapshots, or pieces of them, where routers limit rates: ten times what they
/// ask for, since on their way to the next router they may come closer.
const NEXT_PIECE_AFTER: Duration = Duration::from_millis(10);

/// How long a lossless writer sleeps before it looks again whether its own queue has room.
const QUEUE_PAUSE: Duration = Duration::from_micros(100);

pub(super) struct NetworkOutlet {
    topic: Topic,
    quality: Quality,
    patience: Duration,
    /// Messages sent so far.
    number: u64,
    /// Those of them that gave way in the queue.
    dropped: u64,
    departures: Arc<Departures>,
    sender: Thread,
    /// Ends when everything is sent.
    sent: Receiver<()>,
    _held: Held,
    _own: Own,
}

/// What the writer and its sender share.
struct Departures {
    waiting: ArrayQueue<Parcel>,
    spare: ArrayQueue<Vec<u8>>,
    readers: Readers,
    /// Whether a reader may have come.
    greet: AtomicBool,
    closing: AtomicBool,
}

/// One message with its number on this link.
#[derive(Default)]
struct Parcel {
    number: u64,
    bytes: Vec<u8>,
}

impl NetworkOutlet {
    pub(super) fn open(
        network: &Network,
        topic: Topic,
        reservation: Reservation,
    ) -> Result<Self, OpenError> {
        check(network, topic, Role::Writer)?;
        let quality = network.quality(topic);
        let (keys, id) = (Keys::of(network, topic), draw_id(network.role));
        let departures = Arc::new(Departures::new(quality, reservation));
        let failed = failed(topic);

        let (done, sent) = channel();
        let mut post = Post::new(network, topic, keys.clone(), id.clone());
        let shared = Arc::clone(&departures);
        let run = move || {
            shared.depart(&mut post);
            drop(post);
            drop(done);
        };
        let sender = thread::Builder::new()
            .name(format!("net {}", topic.name()))
            .spawn(run)
            .map_err(no_thread(topic))?;
        let sender = sender.thread().clone();
        // From here on the sender ends with the outlet, or, if that does not come to be, with this.
        let closing = Closing { departures: &departures, sender: &sender };

        let presence = presence::key(network, topic, Role::Writer, &id);
        let (token, shared, greeter) = (presence.clone(), Arc::clone(&departures), sender.clone());
        let declare = move |session: &Session| {
            let mut subscribers = Vec::new();
            if quality.is_paced() {
                let departures = Arc::clone(&shared);
                let room = session
                    .declare_subscriber(keys.room(&id, "*"))
                    .callback(move |sample| departures.readers.room_made(&sample));
                subscribers.push(room.wait()?);
            }
            let (departures, greeter) = (Arc::clone(&shared), greeter.clone());
            let readers =
                session.liveliness().declare_subscriber(keys.readers()).history(true).callback(
                    move |sample| {
                        departures.readers.presence_changed(&sample);
                        departures.greet.store(true, Ordering::Release);
                        greeter.unpark();
                    },
                );
            subscribers.push(readers.wait()?);
            // A query ends when all that it was passed to have let go of it: it needs no answer.
            let join = session.declare_queryable(keys.join(&id)).callback(drop).wait()?;
            let token = session.liveliness().declare_token(&token).wait()?;
            Ok(Declared { _token: Some(token), _subscribers: subscribers, _queryable: Some(join) })
        };
        let held = network.line.hold(Box::new(declare)).map_err(&failed)?;
        let own = Own::new(network, presence);
        for key in list(network, topic)? {
            if let Some(presence) = Presence::of(&key).filter(Presence::is_reader) {
                departures.readers.came(&presence);
            }
        }
        std::mem::forget(closing);
        let patience = network.patience;
        Ok(Self {
            topic,
            quality,
            patience,
            number: 0,
            dropped: 0,
            departures,
            sender,
            sent,
            _held: held,
            _own: own,
        })
    }

    fn send_lossless(&self, mut parcel: Parcel) -> Result<(), SendError> {
        let no_room = SendError::NoRoom { topic: self.topic, waited: self.patience };
        let now = Instant::now();
        let deadline = now.checked_add(self.patience).unwrap_or(now);
        let has_room = self.departures.readers.wait_for_room(
            parcel.number,
            self.quality.depth as u64,
            deadline,
        );
        // Even if one reader has no room, the others shall have the message.
        while let Err(refused) = self.departures.waiting.push(parcel) {
            if Instant::now() >= deadline {
                return Err(no_room);
            }
            parcel = refused;
            thread::sleep(QUEUE_PAUSE);
        }
        self.sender.unpark();
        if has_room { Ok(()) } else { Err(no_room) }
    }
}

impl Outlet for NetworkOutlet {
    fn encoding(&self) -> Encoding {
        Encoding::Wire
    }

    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError> {
        let mut bytes = self.departures.spare.pop().unwrap_or_default();
        bytes.resize(length, 0);
        fill(&mut bytes);
        self.number += 1;
        let parcel = Parcel { number: self.number, bytes };
        if self.quality.delivery == Delivery::Lossless {
            return self.send_lossless(parcel);
        }
        if let Some(oldest) = self.departures.waiting.force_push(parcel) {
            self.dropped += 1;
            self.departures.recycle(oldest);
        }
        self.sender.unpark();
        Ok(())
    }

    /// The sender greets late joiners by itself.
    fn refresh(&mut self) -> Result<(), SendError> {
        Ok(())
    }

    fn dropped(&self) -> u64 {
        self.dropped
    }
}

impl Drop for NetworkOutlet {
    fn drop(&mut self) {
        drop(Closing { departures: &self.departures, sender: &self.sender });
        // It fails when everything is sent, which is well, or when the time is over.
        let _ = self.sent.recv_timeout(FLUSH_TIMEOUT);
    }
}

/// Tells the sender to end.
struct Closing<'a> {
    departures: &'a Departures,
    sender: &'a Thread,
}

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.departures.closing.store(true, Ordering::Release);
        self.sender.unpark();
    }
}

impl Departures {
    /// Buffers for as many messages as can wait, and for the two that are just written and sent.
    fn new(quality: Quality, reservation: Reservation) -> Self {
        let spare = ArrayQueue::new(quality.depth + 2);
        if let Reservation::Whole(bytes) = reservation {
            while spare.push(Vec::with_capacity(bytes)).is_ok() {}
        }
        Self {
            waiting: ArrayQueue::new(quality.depth),
            spare,
            readers: Readers::of(quality.readers),
            greet: AtomicBool::new(false),
            closing: AtomicBool::new(false),
        }
    }

    fn recycle(&self, parcel: Parcel) {
        // If there are enough already, this one goes.
        let _ = self.spare.push(parcel.bytes);
    }

    /// The sender's thread.
    fn depart(&self, post: &mut Post) {
        loop {
            let closing = self.closing.load(Ordering::Acquire);
            self.greet(post);
            while let Some(parcel) = self.waiting.pop() {
                post.send(&parcel);
                self.recycle(parcel);
                self.greet(post);
            }
            if closing {
                return post.flush();
            }
            thread::park();
        }
    }

    /// Gives the history to those who have come.
    fn greet(&self, post: &Post) {
        if self.greet.swap(false, Ordering::Acquire) {
            for newcomer in self.readers.take_newcomers() {
                post.repeat(&newcomer);
            }
        }
    }
}

/// Which messages go first where several wait for one link, and what zenoh's configuration calls
/// that.
pub(super) const fn priority(topic: Topic) -> (Priority, &'static str) {
    match topic {
        Topic::State | Topic::Command => (Priority::RealTime, "real_time"),
        Topic::Residual | Topic::Credit => (Priority::DataHigh, "data_high"),
        Topic::Plan | Topic::Health | Topic::Truth => (Priority::DataLow, "data_low"),
        Topic::Snapshot => (Priority::Background, "background"),
    }
}

/// How messages of one writer go to zenoh.
struct Post {
    line: Arc<Line>,
    keys: Keys,
    id: String,
    data: String,
    quality: Quality,
    priority: Priority,
    congestion: CongestionControl,
    /// The last messages, with their numbers: as many as late joiners get, or, on a lossless link,
    /// as a reader that was cut off can have missed.
    last: VecDeque<(u64, ZBytes)>,
    remembered: usize,
    /// Pieces sent since the router was last asked whether it has passed them on.
    unasked: Cell<usize>,
    /// Where routers limit how often snapshots come: when the router had taken the last one, or a
    /// piece of one.
    apart: Option<Cell<Option<Instant>>>,
}

impl Post {
    fn new(network: &Network, topic: Topic, keys: Keys, id: String) -> Self {
        let (line, quality) = (Arc::clone(&network.line), network.quality(topic));
        let (priority, _) = priority(topic);
        let congestion = match quality.delivery {
            Delivery::Lossless => CongestionControl::Block,
            Delivery::NewestWins => CongestionControl::Drop,
        };
        let data = keys.data(&id);
        let remembered =
            if quality.delivery == Delivery::Lossless { quality.depth } else { quality.history };
        let last = VecDeque::with_capacity(remembered);
        let is_limited = network.role.is_some()
            && topic == Topic::Snapshot
            && quality.delivery == Delivery::NewestWins;
        let apart = is_limited.then(Cell::default);
        Self {
            line,
            keys,
            id,
            data,
            quality,
            priority,
            congestion,
            last,
            remembered,
            unasked: Cell::new(0),
            apart,
        }
    }

    fn send(&mut self, parcel: &Parcel) {
        let bytes = ZBytes::from(parcel.bytes.as_slice());
        if self.remembered > 0 {
            if self.last.len() == self.remembered {
                self.last.pop_front();
            }
            self.last.push_back((parcel.number, bytes.clone()));
        }
        self.put(&self.data, parcel.number, &bytes);
    }

    /// Says to one reader again what it has not heard: the history to a new one, everything to one
    /// that comes back.
    fn repeat(&self, reader: &Newcomer) {
        let key = self.keys.history(&reader.id, &self.id);
        let history = self
            .last
            .iter()
            .rev()
            .take(self.quality.history)
            .next_back()
            .map_or(u64::MAX, |(number, _)| *number);
        let first = reader.had.map_or(history, |had| had + 1);
        for (number, bytes) in self.last.iter().filter(|(number, _)| *number >= first) {
            self.put(&key, *number, bytes);
        }
    }

    fn put(&self, key: &str, number: u64, bytes: &ZBytes) {
        if bytes.len() <= PIECE_BYTES_MAX {
            return self.put_piece(key, Label { number, place: None }, bytes.clone());
        }
        let bytes = bytes.to_bytes();
        for (range, label) in pieces(number, bytes.len()) {
            if self.apart.is_none() && self.unasked.get() == PIECES_AT_ONCE {
                self.flush();
                self.unasked.set(0);
            }
            self.put_piece(key, label, ZBytes::from(&bytes[range]));
            self.unasked.update(|pieces| pieces + 1);
        }
    }

    /// Not express: zenoh waits for nothing while the link is free, and an express message takes a
    /// whole batch, of which a burst finds too few.
    fn put_piece(&self, key: &str, label: Label, bytes: ZBytes) {
        if let Some(taken) = self.apart.as_ref().and_then(Cell::get) {
            thread::sleep(NEXT_PIECE_AFTER.saturating_sub(taken.elapsed()));
        }
        let session = self.line.session();
        let put = session.put(key, bytes).attachment(label.to_bytes());
        let put = put.priority(self.priority).congestion_control(self.congestion);
        // Without a link to the router a message is lost like one on a cut cable: its readers count
        // it.
        let _ = put.wait();
        if let Some(taken) = &self.apart {
            self.flush();
            taken.set(Some(Instant::now()));
        }
    }

    /// Waits until the router has taken everything: a question of the same priority follows it, and
    /// is answered.
    fn flush(&self) {
        let session = self.line.session();
        let question = session
            .get(self.keys.join("nobody"))
            .priority(self.priority)
            .congestion_control(CongestionControl::Block);
        if let Ok(answers) = question.timeout(FLUSH_TIMEOUT).wait() {
            while answers.recv().is_ok() {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Carrier, Carriers, Links, Router};
    use std::error::Error;
    use std::sync::Mutex;
    use std::sync::atomic::AtomicU64;

    /// One says it to zenoh, and the other to its configuration.
    #[test]
    fn a_priority_has_the_name_that_it_has_in_a_configuration() {
        for topic in Topic::ALL {
            let (priority, name) = priority(topic);
            assert_eq!(format!("{priority:?}").to_lowercase(), name.replace('_', ""), "{topic:?}");
        }
    }

    #[test]
    fn what_gives_way_in_the_queue_is_counted_one_by_one() -> Result<(), Box<dyn Error>> {
        const SENT: u64 = 1000;
        let router = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[])?;
        let (carriers, connect) = (Carriers::all(Carrier::Network), router.endpoints().to_vec());
        let network = Network::open(&Links {
            carriers,
            connect,
            ..Links::on_this_machine("t", "", false, 100)
        })?;
        let mut outlet = NetworkOutlet::open(&network, Topic::Credit, Reservation::Whole(8))?;
        // A listener in the same session hears before `put` returns, so that as long as it waits,
        // so does the sender.
        let (gate, heard) = (Arc::new(Mutex::new(())), Arc::new(AtomicU64::new(0)));
        let session = network.line.session();
        let (shared_gate, shared_heard) = (Arc::clone(&gate), Arc::clone(&heard));
        let listener = session
            .declare_subscriber(Keys::of(&network, Topic::Credit).data("*"))
            .callback(move |_| {
                drop(shared_gate.lock());
                shared_heard.fetch_add(1, Ordering::Relaxed);
            });
        let listener = listener.wait().map_err(|error| error.to_string())?;
        let closed = gate.lock();
        for _ in 0..SENT {
            outlet.send(8, &mut |bytes| bytes.fill(0))?;
        }
        drop(closed);
        let dropped = outlet.dropped();
        drop(outlet);
        assert_eq!(heard.load(Ordering::Relaxed) + dropped, SENT);
        let waited = SENT - dropped;
        let depth = Topic::Credit.quality(false).depth as u64;
        assert!(
            (depth..=depth + 1).contains(&waited),
            "{waited}: what the queue holds, and one that was on its way"
        );
        drop(listener);
        Ok(())
    }
}
