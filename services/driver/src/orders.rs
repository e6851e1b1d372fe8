//! Operator → gate: `coxswain arm`, `resume` and `stop`, as files in the run directory.
//!
//! ```text
//! RUN/set/plant-000001.json ──▶ thread of orders ── order ──▶ control thread: Gate::order
//!                               answer ◀─────────── tick ◀──┘
//! ```
//! The thread reads and writes the files. The control thread reads one number whenever it wakes,
//! and replies with another.

use gate::{Order, OrderError};
use process::requests::{Inbox, NotAsked, Outcome, Request, Settled};
use process::step_back;
use protocol::message::{GateState, Participant};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Interval at which the thread checks for an order or a reply.
const LOOK: Duration = Duration::from_millis(2);

/// Outcomes in the low byte of a reply, the tick above it. 0 means no reply.
const FOLLOWED: u64 = 1;
const ESTOP: u64 = 2;
const WRONG_STATE: u64 = 16;

/// Why an order is rejected.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    NotAsked(#[from] NotAsked),
    #[error("{given:?}: expected arm, resume or stop")]
    NoOrder { given: String },
    #[error(transparent)]
    Order(#[from] OrderError),
    #[error("the run has ended")]
    Over,
}

impl Refusal {
    /// Its kind, for programs.
    fn code(&self) -> &'static str {
        match self {
            Self::NotAsked(error) => error.code(),
            Self::NoOrder { .. } => "syntax",
            Self::Order(OrderError::EmergencyStop) => "emergency-stop",
            Self::Order(OrderError::WrongState { .. }) => "gate",
            Self::Over => "run-ended",
        }
    }
}

/// Data that the two threads exchange.
#[derive(Debug, Default)]
struct Slot {
    /// Index of the order in [`Order::ALL`], from 1; 0 for none.
    order: AtomicU32,
    answer: AtomicU64,
    done: AtomicBool,
}

/// Whether the last order of this run that was followed is a stop. A restarted plant stays stopped.
pub(crate) fn ended_with_stop(run: &process::Run) -> bool {
    let settled = (1..).map_while(|number| Settled::read(&run.folder, Participant::Plant, number));
    let followed =
        settled.filter(|settled| matches!(settled.answer.outcome, Outcome::Applied { .. }));
    followed.last().is_some_and(|last| last.request.change.trim() == Order::Stop.name())
}

/// The orders of one run.
#[derive(Debug, Default)]
pub(crate) struct Orders {
    slot: Arc<Slot>,
    thread: Option<JoinHandle<()>>,
}

impl Orders {
    /// Starts the thread, if the run accepts orders.
    pub(crate) fn open(run: &process::Run, plant_epoch: u64) -> Self {
        let inbox = Inbox::open(run, Participant::Plant);
        if !inbox.is_open() {
            return Self::default();
        }
        let slot = Arc::<Slot>::default();
        let thread = thread::spawn({
            let slot = Arc::clone(&slot);
            move || {
                step_back();
                attend(inbox, &slot, plant_epoch);
            }
        });
        Self { slot, thread: Some(thread) }
    }

    /// The waiting order, if there is one. Neither locks nor allocates.
    pub(crate) fn take(&self) -> Option<Order> {
        let place = self.slot.order.swap(0, Ordering::Acquire) as usize;
        Order::ALL.get(place.checked_sub(1)?).copied()
    }

    /// Reports the outcome of the last order in the period of `tick`. Neither locks nor allocates.
    pub(crate) fn answer(&self, tick: u64, outcome: Result<(), OrderError>) {
        let code = match outcome {
            Ok(()) => FOLLOWED,
            Err(OrderError::EmergencyStop) => ESTOP,
            Err(OrderError::WrongState { found, .. }) => WRONG_STATE + u64::from(found.code()),
        };
        self.slot.answer.store(tick << 8 | code, Ordering::Release);
    }
}

impl Drop for Orders {
    fn drop(&mut self) {
        self.slot.done.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has logged the reason.
            let _ = thread.join();
        }
    }
}

fn attend(mut inbox: Inbox, slot: &Slot, plant_epoch: u64) {
    while !slot.done.load(Ordering::Acquire) {
        if let Some(request) = inbox.take() {
            let tick = request.map_err(Refusal::from).and_then(|request| follow(&request, slot));
            inbox.answer(match tick {
                Ok(tick) => Outcome::Applied {
                    plant_epoch,
                    taken_at_tick: tick,
                    ready_at_tick: tick,
                    acts_from_tick: tick,
                },
                Err(refusal) => Outcome::refused(refusal.code(), &refusal),
            });
        }
        thread::sleep(LOOK);
    }
}

/// Passes an order to the control thread, and waits for the tick at which it takes effect.
fn follow(request: &Request, slot: &Slot) -> Result<u64, Refusal> {
    let given = request.change.trim();
    let place = Order::ALL.iter().position(|order| order.name() == given);
    let Some((place, order)) = place.and_then(|place| Some((place, *Order::ALL.get(place)?)))
    else {
        return Err(Refusal::NoOrder { given: given.chars().take(40).collect() });
    };
    slot.order.store(place as u32 + 1, Ordering::Release);
    loop {
        let over = slot.done.load(Ordering::Acquire);
        let answer = slot.answer.swap(0, Ordering::Acquire);
        match answer & 0xff {
            0 if over => return Err(Refusal::Over),
            0 => thread::sleep(LOOK),
            FOLLOWED => return Ok(answer >> 8),
            ESTOP => return Err(OrderError::EmergencyStop.into()),
            code => {
                let found = u32::try_from(code - WRONG_STATE)
                    .ok()
                    .and_then(|code| GateState::try_from(code).ok())
                    .unwrap_or(GateState::Stopped);
                let expected = order.leaves().unwrap_or(found);
                return Err(OrderError::WrongState { found, expected }.into());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use process::requests::{ask, welcome};
    use process::{Pace, Run};
    use std::error::Error;
    use std::path::Path;
    use transport::Links;

    fn run(folder: &Path, lock_step: bool) -> Run {
        Run::new(folder, 1, Links::on_this_machine("orders", folder.to_owned(), lock_step, 0))
    }

    /// Outcome of the order `given` when the control thread replies to every order with `outcome`
    /// at tick 7.
    fn settled(
        given: &str,
        lock_step: bool,
        outcome: Result<(), OrderError>,
    ) -> Result<Outcome, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let run = run(folder.path(), lock_step);
        assert_eq!(run.pace == Pace::LockStep, lock_step);
        let orders = Orders::open(&run, 3);
        let request = Request { who: "ada".into(), asked_unix_nanos: 0, change: given.into() };
        let asked = ask(folder.path(), Participant::Plant, &request)?;
        loop {
            if orders.take().is_some() {
                orders.answer(7, outcome);
            }
            if let Some(settled) = asked.answer() {
                return Ok(settled.answer.outcome);
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn refusal(outcome: Outcome) -> String {
        if let Outcome::Refused { code, .. } = outcome { code } else { format!("{outcome:?}") }
    }

    #[test]
    fn the_reply_to_an_order_has_the_tick_at_which_it_takes_effect() -> Result<(), Box<dyn Error>> {
        let applied = Outcome::Applied {
            plant_epoch: 3,
            taken_at_tick: 7,
            ready_at_tick: 7,
            acts_from_tick: 7,
        };
        assert_eq!(settled("resume", false, Ok(()))?, applied);
        Ok(())
    }

    #[test]
    fn a_restarted_plant_knows_whether_the_last_order_was_a_stop() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        welcome(folder.path())?;
        let run = run(folder.path(), false);
        assert!(!ended_with_stop(&run));
        let orders = Orders::open(&run, 1);
        for (given, stopped) in [("stop", true), ("dance", true), ("resume", false)] {
            let request = Request { who: "ada".into(), asked_unix_nanos: 0, change: given.into() };
            let asked = ask(folder.path(), Participant::Plant, &request)?;
            while asked.answer().is_none() {
                if orders.take().is_some() {
                    orders.answer(7, Ok(()));
                }
                thread::sleep(Duration::from_millis(1));
            }
            assert_eq!(ended_with_stop(&run), stopped, "after {given}");
        }
        Ok(())
    }

    #[test]
    fn an_invalid_order_is_rejected_with_a_code() -> Result<(), Box<dyn Error>> {
        let wrong =
            OrderError::WrongState { found: GateState::Driving, expected: GateState::Stopped };
        for (given, lock_step, outcome, code) in [
            ("resume", false, Err(wrong), "gate"),
            ("resume", false, Err(OrderError::EmergencyStop), "emergency-stop"),
            ("dance", false, Ok(()), "syntax"),
            ("resume", true, Ok(()), "lock-step"),
        ] {
            assert_eq!(refusal(settled(given, lock_step, outcome)?), code);
        }
        Ok(())
    }
}
