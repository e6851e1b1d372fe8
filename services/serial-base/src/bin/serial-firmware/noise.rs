//! A bad cable: lines that are damaged, cut off, lost or late.

use clap::Args;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::VecDeque;

/// Faults of the cable, in both directions.
#[derive(Debug, Clone, Args)]
pub(crate) struct Noise {
    /// Share of the lines that arrive with a few other bytes.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    garble: f64,
    /// Share of the lines that are cut off.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    truncate: f64,
    /// Share of the lines that are lost.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    drop: f64,
    /// Longest delay of a line, in ms. A late line delays those behind it.
    #[arg(long, value_name = "MS", default_value_t = 0)]
    delay: u64,
    /// Seed of all of these.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// One direction of the cable.
#[derive(Debug)]
pub(crate) struct Cable {
    noise: Noise,
    random: Pcg64Mcg,
    /// Lines on their way, each with the time of its arrival \[ns\].
    on_the_way: VecDeque<(u64, Vec<u8>)>,
}

impl Cable {
    /// Another direction has other faults.
    pub(crate) fn new(noise: &Noise, direction: u64) -> Self {
        let random = Pcg64Mcg::seed_from_u64(noise.seed.wrapping_mul(16) + direction);
        Self { noise: noise.clone(), random, on_the_way: VecDeque::new() }
    }

    /// Sends `line` at `now` \[ns\].
    pub(crate) fn put(&mut self, now: u64, line: &[u8]) {
        if self.occurs(self.noise.drop) {
            return;
        }
        let mut line = line.to_vec();
        if self.occurs(self.noise.garble) {
            self.garble(&mut line);
        }
        if self.occurs(self.noise.truncate) {
            line.truncate(self.random.random_range(0..=line.len()));
        }
        let delay = self.random.random_range(0..=self.noise.delay) * 1_000_000;
        let behind = self.on_the_way.back().map_or(0, |(arrival, _)| *arrival);
        self.on_the_way.push_back((behind.max(now + delay), line));
    }

    /// The next line that has arrived at `now` \[ns\].
    pub(crate) fn take(&mut self, now: u64) -> Option<Vec<u8>> {
        let has_arrived = self.on_the_way.front().is_some_and(|(arrival, _)| *arrival <= now);
        has_arrived.then(|| self.on_the_way.pop_front())?.map(|(_, line)| line)
    }

    fn occurs(&mut self, share: f64) -> bool {
        self.random.random::<f64>() < share
    }

    /// Changes 1 to 8 bytes.
    fn garble(&mut self, line: &mut [u8]) {
        for _ in 0..self.random.random_range(1..=8) {
            let place = self.random.random_range(0..line.len().max(1));
            if let Some(byte) = line.get_mut(place) {
                *byte = self.random.random();
            }
        }
    }
}
