//! every topic → watchers, near and far.

use crate::addresses;
use crate::page::{Feed, Page, PageError};
use crate::settings::{Rates, Settings};
use crate::topic_relay::{HealthRelay, TopicRelay};
use process::requests::Answers;
use process::{Pulse, Stop, refusals};
use protocol::access::Breach;
use protocol::message::{
    ModelSnapshot, Participant, Phase, Plan, PlantState, ResidualSample, Truth,
};
use protocol::port::{OpenError, Ports, ReceiveError, Tally};
use protocol::telemetry::{Publisher, TelemetryError, TelemetrySettings};
use protocol::topic::Topic;
use std::thread;
use std::time::{Duration, Instant};

/// Longest sleep: topics other than the plan are looked at as often.
const PATIENCE: Duration = Duration::from_millis(20);

/// The robot cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// No place in the graph.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A topic cannot be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// No way to the watchers.
    #[error(transparent)]
    Telemetry(#[from] TelemetryError),
    /// No way to browsers.
    #[error(transparent)]
    Page(#[from] PageError),
    /// A way for strangers.
    #[error(transparent)]
    Breach(#[from] Breach),
}

/// Shows what is said until `stop` is requested.
///
/// # Errors
/// [`GatewayError`]. A robot that drives does not notice; one that is to start, with certificates, waits for the first gateway of its launch.
pub fn run(ports: &Ports, settings: &Settings, stop: &Stop) -> Result<(), GatewayError> {
    let mut pulse = Pulse::new(ports, Participant::Gateway)?.exposed(settings.run.exposure);
    let rates = settings.rates.of(settings.run.exposure);
    let mut relay = Relay::open(ports, &rates)?;
    let (mut publisher, place) = publisher(settings)?;
    let mut page = page(settings)?;
    // One that comes back does so without: it has been tested where it listens now, and watchers wait for it.
    if let Some(credentials) =
        settings.telemetry.credentials.as_ref().filter(|_| place == Place::New)
    {
        refusals::unlogged(|| publisher.self_test(credentials, pulse.health()))?;
        tracing::info!("strangers are kept out of the telemetry");
    }
    welcome(settings, publisher.endpoints());
    pulse.phase(Phase::Ready);
    let mut answers = if settings.run.restarted {
        Answers::from_now_on(&settings.run.folder)
    } else {
        Answers::all(&settings.run.folder)
    };
    let breath = rates.shortest_interval() / 2;
    while !stop.requested() {
        if relay.plans.source.wait(PATIENCE)? {
            pulse.phase(Phase::Running);
        }
        relay.pass(&mut publisher, page.as_mut().map(Page::feed))?;
        if let Some(page) = &mut page {
            answers.look().iter().for_each(|settled| page.feed().hear_change(settled));
            page.turn(Instant::now());
        }
        relay.count(&mut pulse);
        pulse.beat();
        // Whatever comes meanwhile is looked at together.
        thread::sleep(breath);
    }
    pulse.last_words(Phase::Finished, settings.run.pace);
    Ok(publisher.close()?)
}

/// Where a gateway listens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Where one has welcomed watchers before.
    Known,
    /// Where none has.
    New,
}

/// Listens where this role listened before, if it has been restarted, so that watchers find it again; else where the settings say.
fn publisher(settings: &Settings) -> Result<(Publisher, Place), GatewayError> {
    let root = &settings.run.links.root;
    let before = addresses::endpoints(root);
    let again = || {
        let telemetry = TelemetrySettings { listen: before.clone(), ..settings.telemetry.clone() };
        (!before.is_empty())
            .then(|| Publisher::open(&telemetry, settings.run.period_nanos).ok())
            .flatten()
    };
    Ok(match again() {
        Some(publisher) => (publisher, Place::Known),
        None => (Publisher::open(&settings.telemetry, settings.run.period_nanos)?, Place::New),
    })
}

/// Tells watchers of this machine where they find it.
fn welcome(settings: &Settings, endpoints: &[String]) {
    // Before it is said: who reads that may look there at once.
    if let Err(error) = addresses::note(&settings.run.links.root, endpoints) {
        tracing::warn!(%error, "the endpoints could not be noted for watchers on this machine");
    }
    tracing::info!(robot = %settings.telemetry.robot, endpoints = %endpoints.join(", "), "watchers are welcome");
}

/// Serves the live page where this role served it before, if it has been restarted, so that open pages come back; else where the settings say.
fn page(settings: &Settings) -> Result<Option<Page>, PageError> {
    let root = &settings.run.links.root;
    let page = Page::open(settings, addresses::page(root))?;
    if let Some(page) = &page {
        let address = page.address();
        tracing::info!(%address, "the live page is served");
        if let Err(error) = addresses::note_page(root, address) {
            tracing::warn!(%error, "the address of the live page could not be noted");
        }
    }
    Ok(page)
}

/// All topics on their way to the watchers.
struct Relay {
    states: TopicRelay<PlantState>,
    /// The gateway sleeps on this one. The plan is said when the command is out, so that nobody is woken while an answer is worked out.
    plans: TopicRelay<Plan>,
    healths: HealthRelay,
    residuals: TopicRelay<ResidualSample>,
    snapshots: TopicRelay<ModelSnapshot>,
    truths: TopicRelay<Truth>,
}

impl Relay {
    fn open(ports: &Ports, rates: &Rates) -> Result<Self, OpenError> {
        Ok(Self {
            states: TopicRelay::open(ports, rates.state)?,
            plans: TopicRelay::open(ports, rates.plan)?,
            healths: HealthRelay::open(ports, rates.health)?,
            residuals: TopicRelay::open(ports, rates.residual)?,
            snapshots: TopicRelay::open(ports, rates.snapshot)?,
            truths: TopicRelay::open(ports, rates.truth)?,
        })
    }

    /// The state goes before the plan that answers it.
    fn pass(
        &mut self,
        publisher: &mut Publisher,
        mut page: Option<&mut Feed>,
    ) -> Result<(), GatewayError> {
        let now = Instant::now();
        let state = self.states.pass(now, publisher)?;
        let plan = self.plans.pass(now, publisher)?;
        self.healths.pass(now, publisher, |health| {
            if let Some(page) = &mut page {
                page.hear_health(health, now);
            }
        })?;
        self.residuals.pass(now, publisher)?;
        let snapshot = self.snapshots.pass(now, publisher)?;
        self.truths.pass(now, publisher)?;
        if let Some(page) = page {
            if let Some(state) = &state {
                page.hear_state(state);
            }
            if let Some(plan) = &plan {
                page.hear_plan(plan);
            }
            if let Some(snapshot) = &snapshot {
                page.hear_snapshot(snapshot);
            }
        }
        Ok(())
    }

    /// What one who only looks on has passed over is no loss.
    fn count(&self, pulse: &mut Pulse) {
        for (topic, tally) in [
            (Topic::State, self.states.tally()),
            (Topic::Plan, self.plans.tally()),
            (Topic::Health, self.healths.tally()),
            (Topic::Residual, self.residuals.tally()),
            (Topic::Snapshot, self.snapshots.tally()),
            (Topic::Truth, self.truths.tally()),
        ] {
            pulse.count_source(topic, Tally { lost: 0, ..tally });
        }
    }
}
