use super::*;
use crate::control::tests::told;
use bytemuck::Zeroable;
use protocol::message::GateState;
use std::error::Error;
use std::time::Instant;
use tempfile::TempDir;
use transport::Exchange;

/// Far longer than an answer takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(1);

fn received(commands: &mut Source<Command>) -> Result<Command, Box<dyn Error>> {
    let begin = Instant::now();
    while begin.elapsed() < GIVES_UP_AFTER {
        commands.wait(PATIENCE)?;
        if let Some(command) = commands.next()? {
            return Ok(command);
        }
    }
    Err("no command comes".into())
}

/// In a folder of its own, which keeps what the controller saves at its end.
fn settings(folder: &TempDir) -> Settings {
    let mut settings = told();
    settings.run.folder = folder.path().to_owned();
    settings
}

#[test]
fn above_the_last_epoch_there_is_none_to_claim() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let settings = settings(&folder);
    let (exchange, stop) = (Exchange::new(false, Duration::from_secs(1)), Stop::new());
    let mut states = Ports::in_memory(&exchange, Identity::new(7)).sink::<PlantState>()?;
    let ended = thread::scope(|scope| {
        let controller = scope
            .spawn(|| run(&settings, |identity| Ok(Ports::in_memory(&exchange, identity)), &stop));
        let mut state = PlantState::zeroed();
        state.gate = GateState::Driving.code();
        state.controller_epoch = u64::MAX;
        while !controller.is_finished() {
            state.stamp.tick += 1;
            states.send(&mut state).map_err(|error| error.to_string())?;
            thread::sleep(PATIENCE);
        }
        controller.join().map_err(|_| "the controller has panicked".to_owned())
    })?;
    assert!(matches!(ended, Err(RunError::NoEpochLeft { highest: u64::MAX })), "{ended:?}");
    Ok(())
}

#[test]
fn in_lock_step_a_repeated_state_gets_the_same_bytes_as_its_lost_answer()
-> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let settings = settings(&folder);
    let (exchange, stop) = (Exchange::new(true, Duration::from_secs(1)), Stop::new());
    let ports = Ports::in_memory(&exchange, Identity::new(7));
    let (mut first, mut states) =
        (ports.source::<Command>(Since::First)?, ports.sink::<PlantState>()?);
    thread::scope(|scope| {
        let controller = scope.spawn(|| {
            let connect = |identity| Ok(Ports::in_memory(&exchange, identity));
            run(&settings, connect, &stop).map_err(|error| error.to_string())
        });
        let mut talk = || -> Result<(), Box<dyn Error>> {
            let mut state = PlantState::zeroed();
            state.gate = GateState::Driving.code();
            states.send(&mut state)?;
            let answer = received(&mut first)?;
            // A receiver that was not connected has lost it.
            let mut second = ports.source::<Command>(Since::First)?;
            while !second.wait(PATIENCE)? {
                states.send_stamped(&state)?;
            }
            assert_eq!(received(&mut second)?, answer);
            assert_eq!(
                (first.next()?, first.tally().lost),
                (None, 0),
                "who has received it does not notice"
            );
            state.stamp.tick = 1;
            states.send(&mut state)?;
            assert_eq!(
                (received(&mut second)?.stamp.tick, received(&mut first)?.stamp.tick),
                (1, 1),
                "the clock goes on"
            );
            Ok(())
        };
        let talked = talk();
        stop.request();
        controller.join().map_err(|_| "the controller has panicked")??;
        talked
    })
}
