//! The carrier inside one process: every reader has a queue of its own.
//!
//! Buffers circulate between a queue and its reader, so that nothing is allocated once they have
//! all been used. A lock is taken for every message: this carrier is for tests and experiments, not
//! for a control loop.

use super::carrier::{Receiver, Sender};
use super::links::PATIENCE_MAX;
use super::{Audience, OpenError, ReceiveError, SendError};
use protocol::topic::{Delivery, Quality, TOPIC_COUNT, Topic};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The exchange between the ports of one process; clones are the same exchange.
#[derive(Clone)]
pub struct Exchange {
    shared: Arc<Shared>,
}

struct Shared {
    lock_step: bool,
    patience: Duration,
    topics: [Mutex<Table>; TOPIC_COUNT],
}

/// Writers and readers of one topic.
#[derive(Default)]
struct Table {
    next_id: u64,
    readers: Vec<(u64, Arc<Queue>)>,
    /// Last messages of each writer, while it is there.
    writers: Vec<(u64, VecDeque<Vec<u8>>)>,
}

/// Messages that wait for one reader.
struct Queue {
    quality: Quality,
    state: Mutex<QueueState>,
    arrived: Condvar,
    left: Condvar,
}

#[derive(Default)]
struct QueueState {
    waiting: VecDeque<Vec<u8>>,
    spare: Vec<Vec<u8>>,
    closed: bool,
}

impl Exchange {
    /// `patience` is how long a lossless writer waits for room.
    pub fn new(lock_step: bool, patience: Duration) -> Self {
        let topics = std::array::from_fn(|_| Mutex::default());
        let patience = patience.min(PATIENCE_MAX);
        Self { shared: Arc::new(Shared { lock_step, patience, topics }) }
    }

    #[cfg(feature = "faults")]
    pub(super) fn lock_step(&self) -> bool {
        self.shared.lock_step
    }

    pub(super) fn sender(&self, topic: Topic) -> Result<MemorySender, OpenError> {
        let quality = topic.quality(self.shared.lock_step);
        let mut table = self.shared.table(topic);
        if table.writers.len() >= quality.writers {
            return Err(OpenError::Full { topic, role: "writers", limit: quality.writers });
        }
        let id = table.draw_id();
        table.writers.push((id, VecDeque::new()));
        drop(table);
        Ok(MemorySender {
            exchange: self.clone(),
            topic,
            quality,
            id,
            readers: Vec::new(),
            bytes: Vec::new(),
        })
    }

    pub(super) fn receiver(
        &self,
        topic: Topic,
        audience: Audience,
    ) -> Result<MemoryReceiver, OpenError> {
        let quality = audience.quality(topic, self.shared.lock_step);
        let mut table = self.shared.table(topic);
        if table.readers.len() >= quality.readers {
            return Err(OpenError::Full { topic, role: "readers", limit: quality.readers });
        }
        let queue = Arc::new(Queue::new(quality));
        queue
            .lock()
            .waiting
            .extend(table.writers.iter().flat_map(|(_, history)| history.iter().cloned()));
        let id = table.draw_id();
        table.readers.push((id, Arc::clone(&queue)));
        drop(table);
        Ok(MemoryReceiver { exchange: self.clone(), topic, id, queue })
    }
}

impl Shared {
    fn table(&self, topic: Topic) -> MutexGuard<'_, Table> {
        // A topic's index is below `TOPIC_COUNT`.
        let [first, ..] = &self.topics;
        self.topics
            .get(topic.index())
            .unwrap_or(first)
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    fn draw_id(&mut self) -> u64 {
        self.next_id += 1;
        self.next_id
    }

    /// Keeps `bytes` for late joiners, in the buffer of the message that they replace.
    fn remember(&mut self, writer: u64, bytes: &[u8], depth: usize) {
        if let Some((_, history)) = self.writers.iter_mut().find(|(id, _)| *id == writer) {
            let mut buffer = if history.len() < depth {
                Vec::new()
            } else {
                history.pop_front().unwrap_or_default()
            };
            buffer.clear();
            buffer.extend_from_slice(bytes);
            history.push_back(buffer);
        }
    }
}

impl Queue {
    fn new(quality: Quality) -> Self {
        Self { quality, state: Mutex::default(), arrived: Condvar::new(), left: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, QueueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends `bytes`. On a full lossless link it waits until `deadline`, and returns whether
    /// there was room; else it drops the oldest.
    fn push(&self, bytes: &[u8], deadline: Instant) -> bool {
        let quality = self.quality;
        let mut state = self.lock();
        if quality.delivery == Delivery::Lossless {
            while state.waiting.len() >= quality.depth && !state.closed {
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return false;
                }
                state =
                    self.left.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
            }
        } else if state.waiting.len() >= quality.depth
            && let Some(oldest) = state.waiting.pop_front()
        {
            state.spare.push(oldest);
        }
        let mut buffer = state.spare.pop().unwrap_or_default();
        buffer.clear();
        buffer.extend_from_slice(bytes);
        state.waiting.push_back(buffer);
        drop(state);
        self.arrived.notify_one();
        true
    }
}

/// One writer.
pub(super) struct MemorySender {
    exchange: Exchange,
    topic: Topic,
    quality: Quality,
    id: u64,
    readers: Vec<Arc<Queue>>,
    bytes: Vec<u8>,
}

impl Sender for MemorySender {
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError> {
        self.bytes.resize(length, 0);
        fill(&mut self.bytes);
        {
            // History and readers are read under one lock: a reader that joins now finds the
            // message in one of the two, never in both.
            let mut table = self.exchange.shared.table(self.topic);
            if self.quality.history > 0 {
                table.remember(self.id, &self.bytes, self.quality.history);
            }
            self.readers.clear();
            self.readers.extend(table.readers.iter().map(|(_, queue)| Arc::clone(queue)));
        }
        let patience = self.exchange.shared.patience;
        let deadline = Instant::now() + patience;
        let mut complete = true;
        for reader in &self.readers {
            complete &= reader.push(&self.bytes, deadline);
        }
        self.readers.clear();
        if complete {
            Ok(())
        } else {
            Err(SendError::NoRoom { topic: self.topic, waited: patience })
        }
    }

    fn refresh(&mut self) -> Result<(), SendError> {
        Ok(())
    }
}

impl Drop for MemorySender {
    fn drop(&mut self) {
        self.exchange.shared.table(self.topic).writers.retain(|(id, _)| *id != self.id);
    }
}

/// One reader.
pub(super) struct MemoryReceiver {
    exchange: Exchange,
    topic: Topic,
    id: u64,
    queue: Arc<Queue>,
}

impl Receiver for MemoryReceiver {
    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError> {
        let Some(bytes) = self.queue.lock().waiting.pop_front() else {
            return Ok(false);
        };
        self.queue.left.notify_one();
        visit(&bytes);
        self.queue.lock().spare.push(bytes);
        Ok(true)
    }

    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError> {
        let state = self.queue.lock();
        let (state, _) = self
            .queue
            .arrived
            .wait_timeout_while(state, timeout, |state| state.waiting.is_empty())
            .unwrap_or_else(PoisonError::into_inner);
        Ok(!state.waiting.is_empty())
    }
}

impl Drop for MemoryReceiver {
    fn drop(&mut self) {
        self.exchange.shared.table(self.topic).readers.retain(|(id, _)| *id != self.id);
        self.queue.lock().closed = true;
        self.queue.left.notify_all();
    }
}
