//! One fault on one link: its effect on each message.

use super::anatomy::Anatomy;
use super::random::SplitMix64;
use super::{Fault, HELD_MAX, Kind};
use protocol::VERSION;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// A truncated message ends at a whole word \[bytes\]: carriers may move words.
const WORD_BYTES: u64 = 8;

/// One fault, its generator, and the messages that it holds.
pub(super) struct Stage {
    /// Its place in the settings.
    pub(super) index: usize,
    pub(super) fault: Fault,
    /// Messages in its window.
    pub(super) seen: u64,
    /// How many of them it was applied to.
    pub(super) injected: u64,
    random: SplitMix64,
    held: VecDeque<Held>,
    /// Messages that have passed, for `replay`.
    past: VecDeque<Vec<u8>>,
    /// Numbers of the first message of the window, for `freeze`.
    frozen: Option<Vec<f64>>,
    /// Whether withheld messages are delivered in the end: on a lossless link.
    withheld_returns: bool,
}

struct Held {
    bytes: Vec<u8>,
    due: Due,
}

/// When a held message is released.
enum Due {
    /// At this time.
    At(Instant),
    /// Behind so many later messages.
    After(u64),
    /// Never, unless no later message comes.
    Lost,
}

impl Stage {
    pub(super) fn new(
        index: usize,
        fault: Fault,
        random: SplitMix64,
        withheld_returns: bool,
    ) -> Self {
        let (held, past) = (VecDeque::new(), VecDeque::new());
        Self {
            index,
            fault,
            seen: 0,
            injected: 0,
            random,
            held,
            past,
            frozen: None,
            withheld_returns,
        }
    }

    /// Takes in one message, and appends the released messages to `out`.
    pub(super) fn take(
        &mut self,
        bytes: Vec<u8>,
        now: Instant,
        anatomy: &Anatomy,
        out: &mut Vec<Vec<u8>>,
    ) {
        let held_before = self.held.len();
        let past = (self.fault.kind == Kind::Replay).then(|| bytes.clone());
        if self.picks(&bytes, anatomy) {
            self.apply(bytes, now, anatomy, out);
        } else {
            out.push(bytes);
        }
        self.pass_by(held_before, out);
        if let Some(past) = past {
            self.past.push_back(past);
            while self.past.len() as u64 > self.fault.messages.unwrap_or(1) {
                self.past.pop_front();
            }
        }
        while self.held.len() > HELD_MAX {
            out.extend(
                self.held
                    .pop_front()
                    .filter(|held| !matches!(held.due, Due::Lost))
                    .map(|held| held.bytes),
            );
        }
    }

    /// Appends the messages due at `now` to `out`.
    pub(super) fn release(&mut self, now: Instant, out: &mut Vec<Vec<u8>>) {
        let is_due = |held: &Held| matches!(held.due, Due::At(at) if at <= now);
        while let Some(index) = self.held.iter().position(is_due) {
            out.extend(self.held.remove(index).map(|held| held.bytes));
        }
    }

    /// Appends all held messages to `out`.
    pub(super) fn release_all(&mut self, out: &mut Vec<Vec<u8>>) {
        out.extend(self.held.drain(..).map(|held| held.bytes));
    }

    /// Whether it holds a message that is delivered when no other message arrives.
    pub(super) fn withholds(&self) -> bool {
        self.withheld_returns && !self.held.is_empty()
    }

    /// When the next held message is due by time.
    pub(super) fn next_due(&self) -> Option<Instant> {
        let times = self
            .held
            .iter()
            .filter_map(|held| if let Due::At(at) = held.due { Some(at) } else { None });
        times.min()
    }

    /// Whether the fault applies to this message.
    fn picks(&mut self, bytes: &[u8], anatomy: &Anatomy) -> bool {
        if !anatomy.tick(bytes).is_some_and(|tick| self.fault.window().contains(&tick)) {
            self.frozen = None;
            return false;
        }
        self.seen += 1;
        let happens = self.random.happens(self.fault.probability);
        if self.fault.kind == Kind::Freeze && self.frozen.is_none() {
            self.frozen = anatomy.numbers(bytes);
            return false;
        }
        // A swap takes two messages: the one behind a held message is not held itself.
        happens && (self.fault.kind != Kind::Reorder || self.held.is_empty())
    }

    fn apply(&mut self, bytes: Vec<u8>, now: Instant, anatomy: &Anatomy, out: &mut Vec<Vec<u8>>) {
        let before = self.injected;
        self.injected += 1;
        match self.fault.kind {
            Kind::Drop => self.withhold(bytes),
            Kind::Duplicate => out.extend([bytes.clone(), bytes]),
            Kind::Delay | Kind::Jitter | Kind::Reorder => self.hold(bytes, now, out),
            Kind::Corrupt => {
                let mut damaged = bytes.clone();
                let bit = self.random.below(damaged.len() as u64 * 8);
                if let Some(byte) = damaged.get_mut((bit / 8) as usize) {
                    *byte ^= 1 << (bit % 8);
                }
                out.push(damaged);
                self.withhold(bytes);
            }
            Kind::Truncate => {
                let words = (bytes.len() as u64).div_ceil(WORD_BYTES);
                let kept = ((1 + self.random.below(words.saturating_sub(1))) * WORD_BYTES) as usize;
                out.push(bytes.get(..kept).unwrap_or_default().to_vec());
                self.withhold(bytes);
            }
            Kind::Freeze => {
                let frozen =
                    self.frozen.as_ref().and_then(|numbers| anatomy.with_numbers(&bytes, numbers));
                self.push_altered(bytes, frozen, before, out);
            }
            Kind::Nan | Kind::Flip | Kind::Outlier => {
                let altered = self.with_altered_field(&bytes, anatomy);
                self.push_altered(bytes, altered, before, out);
            }
            Kind::Version => {
                // Any version but that of this program.
                let version =
                    VERSION.wrapping_add(1 + self.random.below(u64::from(u16::MAX)) as u16);
                let altered = anatomy.with_version(&bytes, version);
                if altered.is_some() {
                    self.withhold(bytes.clone());
                }
                self.push_altered(bytes, altered, before, out);
            }
            Kind::Replay => {
                out.push(bytes);
                match self.past.front() {
                    Some(past) => out.push(past.clone()),
                    None => self.injected = before,
                }
            }
        }
    }

    fn with_altered_field(&mut self, bytes: &[u8], anatomy: &Anatomy) -> Option<Vec<u8>> {
        let (kind, amount) = (self.fault.kind, self.fault.amount.unwrap_or_default());
        let (random, number) = (&mut self.random, self.fault.number);
        let chosen = |place: &usize| number.is_none_or(|number| number == *place);
        let mut change = |values: &mut [f64]| match kind {
            Kind::Flip => (0..)
                .zip(values)
                .filter(|(place, _)| chosen(place))
                .for_each(|(_, value)| *value = -*value),
            Kind::Outlier => {
                for (_, value) in (0..).zip(values).filter(|(place, _)| chosen(place)) {
                    *value += amount * (2.0 * random.share() - 1.0);
                }
            }
            _ => {
                let choice = random.below(values.len() as u64) as usize;
                values.iter_mut().skip(choice).take(1).for_each(|value| *value = f64::NAN);
            }
        };
        anatomy.with_field(bytes, self.fault.field.as_deref().unwrap_or_default(), &mut change)
    }

    fn push_altered(
        &mut self,
        bytes: Vec<u8>,
        altered: Option<Vec<u8>>,
        before: u64,
        out: &mut Vec<Vec<u8>>,
    ) {
        if altered.is_none() {
            self.injected = before;
        }
        out.push(altered.unwrap_or(bytes));
    }

    fn withhold(&mut self, bytes: Vec<u8>) {
        if self.withheld_returns {
            self.held.push_back(Held { bytes, due: Due::Lost });
        }
    }

    fn hold(&mut self, bytes: Vec<u8>, now: Instant, out: &mut Vec<Vec<u8>>) {
        let most = self.fault.millis.or(self.fault.messages).unwrap_or(1);
        let amount =
            if self.fault.kind == Kind::Jitter { self.random.below(most + 1) } else { most };
        if amount == 0 {
            out.push(bytes);
            return;
        }
        let due = if self.fault.millis.is_some() {
            Due::At(now + Duration::from_millis(amount))
        } else {
            Due::After(amount)
        };
        self.held.push_back(Held { bytes, due });
    }

    /// A later message has passed the first `count` of those held.
    fn pass_by(&mut self, count: usize, out: &mut Vec<Vec<u8>>) {
        let mut index = 0;
        for _ in 0..count {
            let Some(held) = self.held.get_mut(index) else { return };
            match &mut held.due {
                Due::At(_) => {
                    index += 1;
                    continue;
                }
                Due::After(left) if *left > 1 => {
                    *left -= 1;
                    index += 1;
                    continue;
                }
                Due::After(_) | Due::Lost => {}
            }
            out.extend(
                self.held
                    .remove(index)
                    .filter(|held| !matches!(held.due, Due::Lost))
                    .map(|held| held.bytes),
            );
        }
    }
}
