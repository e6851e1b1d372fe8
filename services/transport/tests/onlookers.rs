//! In lock step a link loses nothing for its members, and no writer waits for a watcher.

use bytemuck::Zeroable;
use protocol::message::PlantState;
use protocol::topic::Topic;
use std::error::Error;
use std::time::Duration;
use transport::{Exchange, Identity, Links, OpenError, Ports, Since, Source, sweep};

type Outcome = Result<(), Box<dyn Error>>;

const PATIENCE: Duration = Duration::from_millis(200);

/// Runs `promise` on every carrier that supports watchers, in lock step.
fn on_each(promise: impl Fn(&dyn Fn() -> Result<Ports, OpenError>) -> Outcome) -> Outcome {
    let exchange = Exchange::new(true, PATIENCE);
    promise(&|| Ok(Ports::in_memory(&exchange, Identity::new(1))))?;
    let folder = tempfile::tempdir()?;
    let links = Links::on_this_machine(
        format!("o{}", Identity::new(1).writer % 100_000_000),
        folder.path().join("r"),
        true,
        200,
    );
    let kept = promise(&|| Ports::open(&links, Identity::new(1)));
    sweep(&links)?;
    kept
}

fn ticks(source: &mut Source<PlantState>) -> Result<Vec<u64>, Box<dyn Error>> {
    let mut ticks = Vec::new();
    while let Some(state) = source.next()? {
        ticks.push(state.stamp.tick);
    }
    Ok(ticks)
}

#[test]
fn a_watcher_that_does_not_read_delays_no_process_and_then_sees_the_newest() -> Outcome {
    on_each(|open| {
        let (plant, controller, gateway) = (open()?, open()?, open()?);
        let mut member = controller.source::<PlantState>(Since::First)?;
        let mut onlooker = gateway.watcher::<PlantState>()?;
        let mut sink = plant.sink::<PlantState>()?;
        let many = 3 * Topic::State.quality(true).depth as u64;
        let mut received = Vec::new();
        for tick in 0..many {
            let mut state = PlantState::zeroed();
            state.stamp.tick = tick;
            sink.send(&mut state)?;
            received.append(&mut ticks(&mut member)?);
        }
        assert_eq!(received, (0..many).collect::<Vec<_>>(), "the member has lost something");
        assert_eq!(onlooker.latest()?.map(|state| state.stamp.tick), Some(many - 1));
        Ok(())
    })
}

#[test]
fn a_late_watcher_sees_the_last_message() -> Outcome {
    on_each(|open| {
        let (plant, gateway) = (open()?, open()?);
        let mut sink = plant.sink::<PlantState>()?;
        sink.send(&mut PlantState::zeroed())?;
        let mut onlooker = gateway.watcher::<PlantState>()?;
        sink.refresh()?;
        assert_eq!(ticks(&mut onlooker)?, [0]);
        assert_eq!(onlooker.tally().lost, 0);
        Ok(())
    })
}
