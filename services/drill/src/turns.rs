//! When each exercise runs.
//!
//! | exercise                                 | runs                                          |
//! |------------------------------------------|-----------------------------------------------|
//! | without a clock: lock step, or no graph  | first on one worker, beside all others        |
//! | in real time                             | first on the other workers, then on all       |
//! | in real time, and the network must be on | last, while no other one runs                 |
//! | time                                     |                                               |
//!
//! Processes of one graph cannot be late because of processes of lower priority. But its bridges
//! wait for the controllers of other graphs, which have a higher priority. The witness has a still
//! higher one, so it is not late then and excuses nothing. So an exercise whose bridges must be on
//! time runs alone.

use super::catalogue::{Exercise, Task};
use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// The exercises that wait.
#[derive(Debug)]
pub(super) struct Turns {
    waiting: Mutex<Waiting>,
    machine: RwLock<()>,
}

/// Indices of exercises.
#[derive(Debug, Default)]
struct Waiting {
    without_clock: VecDeque<usize>,
    in_real_time: VecDeque<usize>,
    alone: VecDeque<usize>,
}

/// What an exercise may use while this value lives.
#[derive(Debug)]
pub(super) enum Machine<'a> {
    /// The machine, beside other exercises.
    Shared(#[expect(dead_code, reason = "it ends with this value")] RwLockReadGuard<'a, ()>),
    /// The machine alone.
    Whole(#[expect(dead_code, reason = "it ends with this value")] RwLockWriteGuard<'a, ()>),
}

impl Turns {
    /// All of `exercises` wait.
    pub(super) fn new(exercises: &[Exercise]) -> Self {
        let mut waiting = Waiting::default();
        for (index, exercise) in exercises.iter().enumerate() {
            match &exercise.task {
                Task::Damaged(_) => waiting.without_clock.push_back(index),
                Task::Launch(launch) if launch.lock_step => waiting.without_clock.push_back(index),
                Task::Between(failure, _) if failure.is_harmless() => {
                    waiting.alone.push_back(index);
                }
                _ => waiting.in_real_time.push_back(index),
            }
        }
        Self { waiting: Mutex::new(waiting), machine: RwLock::new(()) }
    }

    /// The next exercise for `worker`, when its turn has come.
    pub(super) fn next(&self, worker: u64) -> Option<(usize, Machine<'_>)> {
        let (index, is_alone) = {
            let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
            let Waiting { without_clock, in_real_time, alone } = &mut *waiting;
            let [first, second] = if worker == 0 {
                [without_clock, in_real_time]
            } else {
                [in_real_time, without_clock]
            };
            match first.pop_front().or_else(|| second.pop_front()) {
                Some(index) => (index, false),
                None => (alone.pop_front()?, true),
            }
        };
        Some((index, if is_alone { self.whole() } else { self.shared() }))
    }

    fn shared(&self) -> Machine<'_> {
        Machine::Shared(self.machine.read().unwrap_or_else(PoisonError::into_inner))
    }

    fn whole(&self) -> Machine<'_> {
        Machine::Whole(self.machine.write().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::{Extent, exercises};
    use std::collections::BTreeSet;

    #[test]
    fn each_exercise_has_one_turn_and_what_needs_the_machine_comes_last() {
        let all = exercises(Extent::Quick, false);
        let turns = Turns::new(&all);
        let mut order = Vec::new();
        while let Some((index, machine)) = turns.next(order.len() as u64 % 3) {
            let is_whole = matches!(machine, Machine::Whole(_));
            order.push((index, is_whole));
        }
        let once: BTreeSet<usize> = order.iter().map(|(index, _)| *index).collect();
        assert_eq!((once.len(), order.len()), (all.len(), all.len()));
        let whole: Vec<&str> = order
            .iter()
            .skip_while(|(_, is_whole)| !is_whole)
            .map(|(index, is_whole)| if *is_whole { all[*index].fault } else { "shared" })
            .collect();
        assert_eq!(whole, ["slow link", "lost host"]);
        assert_eq!(all[order[0].0].carrier, crate::catalogue::Carrier::None);
        assert_eq!(all[order[1].0].fault, "kill");
    }
}
