//! How much later states arrive while a snapshot of a megabyte crosses the same slow link each
//! second. Two bridges and two hosts, over a relay that lets 100 Mbit/s pass.
//!
//! `cargo bench -p bridge --bench slow_link`
#![expect(clippy::print_stdout, reason = "figures are what a bench is for")]

#[path = "../tests/bridges/certificates.rs"]
#[expect(dead_code, reason = "the tests use more of it")]
mod certificates;
#[path = "../tests/bridges/hosts.rs"]
#[expect(dead_code, reason = "the tests use more of it")]
mod hosts;
#[path = "../tests/bridges/messages.rs"]
#[expect(dead_code, reason = "the tests use more of it")]
mod messages;
#[path = "../tests/bridges/relay.rs"]
#[expect(dead_code, reason = "the tests use more of it")]
mod relay;

use hosts::{Failure, Pair};
use messages::{snapshot, state};
use protocol::clock::monotonic_nanos;
use protocol::message::{ModelSnapshot, PlantState};
use std::thread;
use std::time::Duration;
use transport::{Sink, Source};

/// The link \[bytes/s\].
const LINK: u64 = 12_500_000;
/// States of each part, one per 20 ms.
const STATES: u64 = 1_000;
const PERIOD: Duration = Duration::from_millis(20);
/// States from one snapshot to the next: a second.
const APART: u64 = 50;
/// Data points of 6 inputs: a megabyte.
const POINTS: u32 = 10_000;

fn main() -> Result<(), Failure> {
    let (pair, _relay) = Pair::slow(LINK)?;
    let _bridges = pair.start()?;
    let mut states: Sink<PlantState> = pair.robot.ports.sink()?;
    let mut snapshots: Sink<ModelSnapshot> = pair.robot.ports.sink()?;
    let mut arrived: Source<PlantState> = pair.control.source()?;
    let mut adopted: Source<ModelSnapshot> = pair.control.source()?;
    for (part, with_snapshots) in [("states alone", false), ("with snapshots", true)] {
        let (mut late, mut bytes, mut whole) = (Vec::new(), 0, 0);
        for tick in 1..=STATES {
            if with_snapshots && tick % APART == 1 {
                let mut model = snapshot(tick, POINTS);
                snapshots.send(&mut model)?;
                bytes = protocol::message::Message::byte_len(&model);
                // The state comes while it is on its way.
                thread::sleep(Duration::from_millis(5));
            }
            let begin = monotonic_nanos();
            states.send(&mut state(tick))?;
            while arrived.latest()?.is_none_or(|one| one.stamp.tick != tick) {
                arrived.wait(PERIOD)?;
            }
            let nanos = monotonic_nanos() - begin;
            late.push(nanos);
            while adopted.next()?.is_some() {
                whole += 1;
            }
            thread::sleep(PERIOD.saturating_sub(Duration::from_nanos(nanos)));
        }
        late.sort_unstable();
        let at = |percent: usize| late[(late.len() - 1) * percent / 100] as f64 * 1e-6;
        println!(
            "{part:15} state p50 {:.2} ms  p99 {:.2} ms  max {:.2} ms; \
             {whole} snapshots of {bytes} bytes arrived",
            at(50),
            at(99),
            at(100)
        );
    }
    Ok(())
}
