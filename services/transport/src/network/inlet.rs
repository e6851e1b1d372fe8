//! One reader on the network: zenoh's threads fill a bounded queue, which the reader's thread
//! empties.

use super::bell::{Bell, Slept};
use super::keys::{Keys, last};
use super::line::{Declared, Held, Line};
use super::pieces::{Label, Unfinished};
use super::presence::{self, Own, Role, check, draw_id};
use super::rates::Rates;
use super::{ANSWER_TIMEOUT, Network, failed, no_thread};
use crate::carrier::{Encoding, Inlet};
use crate::{OpenError, ReceiveError};
use crossbeam_queue::ArrayQueue;
use protocol::topic::{Delivery, Quality, Topic};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Writers that are remembered, those gone included.
const ORIGINS_MAX: usize = 64;

pub(super) struct NetworkInlet {
    topic: Topic,
    arrivals: Arc<Arrivals>,
    /// Reports room to the writers of a lossless link.
    reporter: Option<JoinHandle<()>>,
    _held: Held,
    /// Nothing of a reader that no writer knows of.
    _own: Option<Own>,
}

/// What zenoh's threads, the reader and the reporter share.
struct Arrivals {
    quality: Quality,
    waiting: ArrayQueue<Parcel>,
    spare: ArrayQueue<Vec<u8>>,
    bell: Bell,
    /// Locked by the reader on lossless links only.
    ledger: Mutex<Ledger>,
    reporter: Mutex<Option<thread::Thread>>,
    closing: AtomicBool,
}

struct Parcel {
    /// Serial number of the origin.
    origin: u64,
    bytes: Vec<u8>,
}

/// Where messages come from.
#[derive(Default)]
struct Ledger {
    next: u64,
    origins: Vec<Origin>,
    /// How often each role is heard, if that is limited.
    rates: Option<Rates>,
}

/// One writer as this reader sees it.
struct Origin {
    serial: u64,
    id: String,
    /// Number of the last message that came.
    last: u64,
    /// Messages of it that wait.
    waiting: u64,
    /// Up to where room was reported; nothing yet if none.
    reported: Option<u64>,
    /// Since when something is missing in front of what comes.
    missing: Option<Instant>,
    /// A long message on its way.
    unfinished: Unfinished,
}

/// How long a lossless reader waits for what is missing to be said again, before it goes on
/// without.
const MISSING_MAX: Duration = Duration::from_secs(1);

impl NetworkInlet {
    /// A reader that the writers know of.
    pub(super) fn open(network: &Network, topic: Topic) -> Result<Self, OpenError> {
        check(network, topic, Role::Reader)?;
        let (keys, id) = (Keys::of(network, topic), draw_id(network.role));
        let (line, failed) = (&network.line, failed(topic));
        let arrivals = Arrivals::new(network.quality(topic), Rates::on(topic, network))
            .map_err(|error| failed(error.into()))?;
        let arrivals = Arc::new(arrivals);
        let presence = presence::key(network, topic, Role::Reader, &id);
        let heard =
            [Some(keys.data("*")), arrivals.quality.says_again().then(|| keys.history(&id, "*"))];
        let (token, shared) = (presence.clone(), Arc::clone(&arrivals));
        let declare = move |session: &Session| {
            let subscribers = heard
                .iter()
                .flatten()
                .map(|key| listen(session, key, &shared))
                .collect::<Result<_, _>>()?;
            let token = session.liveliness().declare_token(&token).wait()?;
            Ok(Declared { _token: Some(token), _subscribers: subscribers, _queryable: None })
        };
        let held = line.hold(Box::new(declare)).map_err(&failed)?;
        let own = Own::new(network, presence);

        let mut reporter = None;
        if arrivals.quality.delivery == Delivery::Lossless {
            let (shared, line, keys, id) =
                (Arc::clone(&arrivals), Arc::clone(line), keys.clone(), id);
            let report = move || shared.report(&line, &keys, &id);
            let thread = thread::Builder::new()
                .name(format!("room {}", topic.name()))
                .spawn(report)
                .map_err(no_thread(topic))?;
            *arrivals.reporter.lock().unwrap_or_else(PoisonError::into_inner) =
                Some(thread.thread().clone());
            reporter = Some(thread);
        }
        let inlet = Self { topic, arrivals, reporter, _held: held, _own: Some(own) };
        meet_writers(&line.session(), &keys).map_err(&failed)?;
        Ok(inlet)
    }

    /// A reader that no writer knows of, and that none waits for.
    pub(super) fn watch(network: &Network, topic: Topic) -> Result<Self, OpenError> {
        let failed = failed(topic);
        let arrivals = Arrivals::new(topic.watched_quality(), Rates::on(topic, network))
            .map_err(|error| failed(error.into()))?;
        let arrivals = Arc::new(arrivals);
        let (shared, data) = (Arc::clone(&arrivals), Keys::of(network, topic).data("*"));
        let declare = move |session: &Session| {
            Ok(Declared {
                _token: None,
                _subscribers: vec![listen(session, &data, &shared)?],
                _queryable: None,
            })
        };
        let held = network.line.hold(Box::new(declare)).map_err(&failed)?;
        Ok(Self { topic, arrivals, reporter: None, _held: held, _own: None })
    }

    fn something_waits(&self) -> bool {
        !self.arrivals.waiting.is_empty()
    }
}

/// Hears what is said under `key`.
fn listen(
    session: &Session,
    key: &str,
    arrivals: &Arc<Arrivals>,
) -> Result<Subscriber<()>, zenoh::Error> {
    let arrivals = Arc::clone(arrivals);
    session.declare_subscriber(key).callback(move |sample| arrivals.arrived(&sample)).wait()
}

/// Waits until every writer knows of the reader that has just been declared: the question travels
/// behind that.
fn meet_writers(session: &Session, keys: &Keys) -> Result<(), zenoh::Error> {
    let question =
        session.get(keys.join("*")).target(QueryTarget::All).consolidation(ConsolidationMode::None);
    let answers = question.timeout(ANSWER_TIMEOUT).wait()?;
    while answers.recv().is_ok() {}
    Ok(())
}

impl Inlet for NetworkInlet {
    fn encoding(&self) -> Encoding {
        Encoding::Wire
    }

    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError> {
        let Some(parcel) = self.arrivals.waiting.pop() else {
            return Ok(false);
        };
        visit(&parcel.bytes);
        if self.arrivals.quality.delivery == Delivery::Lossless {
            self.arrivals.taken(parcel.origin);
        }
        self.arrivals.recycle(parcel.bytes);
        Ok(true)
    }

    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError> {
        if self.something_waits() {
            return Ok(true);
        }
        let deadline = Instant::now().checked_add(timeout);
        loop {
            self.arrivals.bell.arm();
            if self.something_waits() {
                return Ok(true);
            }
            let left = deadline.map_or(Duration::MAX, |deadline| {
                deadline.saturating_duration_since(Instant::now())
            });
            if left.is_zero() {
                return Ok(false);
            }
            let slept = self.arrivals.bell.sleep(left);
            let failure = |_| ReceiveError::Carrier {
                topic: self.topic,
                reason: "its events cannot be waited for",
            };
            if slept.map_err(failure)? == Slept::Interrupted {
                return Ok(self.something_waits());
            }
        }
    }
}

impl Drop for NetworkInlet {
    fn drop(&mut self) {
        self.arrivals.closing.store(true, Ordering::Release);
        if let Some(reporter) = self.reporter.take() {
            reporter.thread().unpark();
            let _ = reporter.join();
        }
    }
}

impl Arrivals {
    fn new(quality: Quality, rates: Option<Rates>) -> Result<Self, std::io::Error> {
        // Each writer of a lossless link is promised room for itself, and for its history.
        let capacity = match quality.delivery {
            Delivery::NewestWins => quality.depth,
            Delivery::Lossless => (quality.depth + quality.history) * quality.writers,
        };
        Ok(Self {
            quality,
            waiting: ArrayQueue::new(capacity),
            spare: ArrayQueue::new(quality.depth + 2),
            bell: Bell::new()?,
            ledger: Mutex::new(Ledger { rates, ..Ledger::default() }),
            reporter: Mutex::default(),
            closing: AtomicBool::new(false),
        })
    }

    /// Called by zenoh.
    fn arrived(&self, sample: &Sample) {
        let label = sample.attachment().and_then(|label| Label::of(&label.to_bytes()));
        let number = label.map(|label| label.number);
        let writer = last(sample.key_expr().as_str());
        let mut ledger = self.ledger();
        if let Some(rates) = &mut ledger.rates {
            let now = Instant::now();
            if !(rates.admit(writer, now)
                && rates.believe(writer, &sample.payload().to_bytes(), now))
            {
                return;
            }
        }
        let origin = ledger.origin(writer);
        if number.is_some_and(|number| number <= origin.last) {
            // It says so because it does not know how far this reader has come.
            origin.reported = None;
            return self.wake_reporter();
        }
        let Some(bytes) = self.whole(origin, label, sample) else { return };
        if let Some(number) = number {
            if self.quality.delivery == Delivery::Lossless
                && origin.waits_for_what_is_before(number)
            {
                return self.recycle(bytes);
            }
            origin.last = number;
        }
        let parcel = Parcel { origin: origin.serial, bytes };
        if self.quality.delivery == Delivery::NewestWins {
            if let Some(oldest) = self.waiting.force_push(parcel) {
                self.recycle(oldest.bytes);
            }
        } else {
            // A writer that does not keep to the room that it has loses what is too much.
            if origin.waiting < self.quality.depth as u64 && self.waiting.push(parcel).is_ok() {
                origin.waiting += 1;
            }
            if number.is_some() && origin.report_is_due(self.quality.depth as u64) {
                self.wake_reporter();
            }
        }
        drop(ledger);
        self.bell.ring();
    }

    /// The message, unless there is more of it to come.
    fn whole(&self, origin: &mut Origin, label: Option<Label>, sample: &Sample) -> Option<Vec<u8>> {
        let slices = sample.payload().slices();
        if let Some(Label { number, place: Some(place) }) = label {
            return origin.unfinished.take(number, place, slices);
        }
        let mut bytes = self.spare.pop().unwrap_or_default();
        bytes.clear();
        slices.for_each(|slice| bytes.extend_from_slice(slice));
        Some(bytes)
    }

    fn recycle(&self, bytes: Vec<u8>) {
        // If there are enough already, this one goes.
        let _ = self.spare.push(bytes);
    }

    /// A message of `origin` has been taken out of the queue.
    fn taken(&self, origin: u64) {
        let mut ledger = self.ledger();
        if let Some(origin) = ledger.origins.iter_mut().find(|known| known.serial == origin) {
            origin.waiting = origin.waiting.saturating_sub(1);
            if origin.report_is_due(self.quality.depth as u64) {
                self.wake_reporter();
            }
        }
    }

    /// The reporter's thread.
    fn report(&self, line: &Line, keys: &Keys, id: &str) {
        while !self.closing.load(Ordering::Acquire) {
            let due = self.ledger().due_reports(self.quality.depth as u64);
            for (outlet, number) in due {
                let session = line.session();
                let put = session.put(keys.room(&outlet, id), number.to_le_bytes().as_slice());
                let put = put
                    .priority(Priority::RealTime)
                    .congestion_control(CongestionControl::Block)
                    .express(true);
                // Without a link the writer does not know this reader any more; when it does again,
                // it starts anew.
                let _ = put.wait();
            }
            thread::park();
        }
    }

    fn wake_reporter(&self) {
        if let Some(reporter) =
            self.reporter.lock().unwrap_or_else(PoisonError::into_inner).as_ref()
        {
            reporter.unpark();
        }
    }

    fn ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ledger {
    /// The origin of that name, made if it is new.
    fn origin(&mut self, id: &str) -> &mut Origin {
        let index = self.origins.iter().position(|origin| origin.id == id).unwrap_or_else(|| {
            if self.origins.len() >= ORIGINS_MAX
                && let Some(oldest) = self.origins.iter().position(|origin| origin.waiting == 0)
            {
                self.origins.remove(oldest);
            }
            self.next += 1;
            let (serial, id) = (self.next, id.to_owned());
            self.origins.push(Origin {
                serial,
                id,
                last: 0,
                waiting: 0,
                reported: None,
                missing: None,
                unfinished: Unfinished::default(),
            });
            self.origins.len() - 1
        });
        &mut self.origins[index]
    }

    /// Which outlets are to be told which number. They count as told.
    fn due_reports(&mut self, depth: u64) -> Vec<(String, u64)> {
        let due = self.origins.iter_mut().filter(|origin| origin.report_is_due(depth));
        due.map(|origin| {
            origin.reported = Some(origin.handled());
            (origin.id.clone(), origin.handled())
        })
        .collect()
    }
}

impl Origin {
    /// Whether message `number` must wait. After a cut the link returns a moment before its writer
    /// detects the reader. A message of that moment arrives before the missed ones. The writer then
    /// sends all of them again, in order.
    fn waits_for_what_is_before(&mut self, number: u64) -> bool {
        if self.last == 0 || number == self.last + 1 {
            self.missing = None;
            return false;
        }
        self.missing.get_or_insert_with(Instant::now).elapsed() < MISSING_MAX
    }

    /// Number of the last message that takes no room any more.
    fn handled(&self) -> u64 {
        self.last.saturating_sub(self.waiting)
    }

    /// At first, when a quarter of the room is free again, and with each message once the writer
    /// may have none left.
    fn report_is_due(&self, depth: u64) -> bool {
        self.last > 0
            && self.reported.is_none_or(|reported| {
                let handled = self.handled();
                handled > reported
                    && (handled - reported >= (depth / 4).max(1) || self.last - reported >= depth)
            })
    }
}
