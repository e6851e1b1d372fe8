//! The gateway with a plant that only publishes.

use bytemuck::Zeroable;
use gateway::addresses;
use gateway::run::GatewayError;
use gateway::settings::{About, PageSettings, Rates, Settings};
use network::telemetry::{TelemetryMessage, TelemetrySettings, Watcher};
use process::{Run, Stop};
use protocol::message::{Health, Participant, Phase, PlantState};
use std::error::Error;
use std::path::Path;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use transport::{Exchange, Identity, Links, Ports, Since, Source};

type Outcome = Result<(), Box<dyn Error>>;

const PATIENCE: Duration = Duration::from_mins(1);
const SOON: Duration = Duration::from_millis(20);

fn settings(folder: &Path, rates: Rates) -> Settings {
    let links = Links::on_this_machine("test", folder, true, 1000);
    let run = Run::new(folder, 100_000_000, links);
    let telemetry = TelemetrySettings {
        listen: vec!["tcp/127.0.0.1:0".into()],
        robot: "test".into(),
        credentials: None,
    };
    Settings {
        run,
        has_plant: false,
        telemetry,
        rates,
        page: PageSettings { listen: "127.0.0.1:0".into() },
        about: About::default(),
    }
}

/// A gateway on a thread of its own, in lock step over memory.
struct Fixture {
    exchange: Exchange,
    ports: Ports,
    stop: Stop,
    thread: JoinHandle<Result<(), GatewayError>>,
    healths: Source<Health>,
}

impl Fixture {
    fn start(folder: &Path, rates: Rates) -> Result<Self, Box<dyn Error>> {
        let exchange = Exchange::new(true, Duration::from_secs(1));
        let (settings, stop) = (settings(folder, rates), Stop::new());
        let ports = Ports::in_memory(&exchange, Identity::new(1));
        let healths = ports.source(Since::First)?;
        let thread = {
            let (exchange, stop) = (exchange.clone(), stop.clone());
            thread::spawn(move || {
                gateway::run::run(&Ports::in_memory(&exchange, Identity::new(1)), &settings, &stop)
            })
        };
        let mut fixture = Self { exchange, ports, stop, thread, healths };
        fixture.wait_for(Phase::Ready)?;
        Ok(fixture)
    }

    fn wait_for(&mut self, phase: Phase) -> Outcome {
        let begin = Instant::now();
        while begin.elapsed() < PATIENCE {
            self.healths.wait(SOON)?;
            while let Some(health) = self.healths.next()? {
                if health.participant() == Some(Participant::Gateway) && health.phase() >= phase {
                    return Ok(());
                }
            }
        }
        Err(format!("the gateway is not {phase}").into())
    }

    fn end(self) -> Outcome {
        self.stop.request();
        self.thread.join().map_err(|_| "the gateway has panicked")??;
        drop(self.exchange);
        Ok(())
    }
}

#[test]
fn states_of_the_plant_reach_the_watcher() -> Outcome {
    let folder = tempfile::tempdir()?;
    let fixture = Fixture::start(folder.path(), Rates::default())?;
    let endpoints = addresses::endpoints(folder.path());
    let mut watcher =
        Watcher::open(endpoints.first().ok_or("no endpoint was noted")?, Some("test"))?;
    let mut sink = fixture.ports.sink::<PlantState>()?;
    let begin = Instant::now();
    let mut received = Vec::new();
    for tick in 0.. {
        let mut state = PlantState::zeroed();
        state.stamp.tick = tick;
        sink.send(&mut state)?;
        if let Some(telemetry) = watcher.next(SOON)?
            && let TelemetryMessage::State(state) = telemetry.message
        {
            received.push(state.stamp.tick);
        }
        if received.len() >= 5 || begin.elapsed() > PATIENCE {
            break;
        }
    }
    assert!(received.len() >= 5 && received.is_sorted(), "{received:?}");
    fixture.end()
}

#[test]
fn a_restarted_gateway_has_the_same_addresses() -> Outcome {
    let folder = tempfile::tempdir()?;
    Fixture::start(folder.path(), Rates::default())?.end()?;
    let before = (addresses::endpoints(folder.path()), addresses::page(folder.path()));
    assert!(before.1.is_some(), "the page was not noted");
    let fixture = Fixture::start(folder.path(), Rates::default())?;
    assert_eq!((addresses::endpoints(folder.path()), addresses::page(folder.path())), before);
    fixture.end()
}
