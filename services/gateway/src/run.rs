//! Every topic → watchers, on this machine and remote.

use crate::addresses;
use crate::page::{Feed, Page, PageError};
use crate::settings::{Rates, Settings};
use crate::topic_relay::{KindsRelay, TopicRelay};
use network::Breach;
use network::telemetry::{Publisher, TelemetryError, TelemetrySettings};
use process::requests::Answers;
use process::{Pulse, Stop};
use protocol::message::{
    Goal, Health, ModelSnapshot, ObstacleSource, Obstacles, Participant, Phase, Plan, PlantState,
    ResidualSample, Truth,
};
use protocol::topic::Topic;
use std::thread;
use std::time::{Duration, Instant};
use transport::{OpenError, Ports, ReceiveError, Tally};

/// Longest sleep. Topics other than the plan are read at least this often.
const PATIENCE: Duration = Duration::from_millis(20);

/// The gateway failed.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// It could not join the graph.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A topic could not be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The endpoints for watchers could not be opened.
    #[error(transparent)]
    Telemetry(#[from] TelemetryError),
    /// The live page could not be served.
    #[error(transparent)]
    Page(#[from] PageError),
    /// An unauthenticated peer could connect.
    #[error(transparent)]
    Breach(#[from] Breach),
}

/// Relays the topics until `stop` is requested.
///
/// # Errors
/// [`GatewayError`]. The error has no effect on a driving robot. A robot that starts with
/// certificates waits for the first gateway of its launch.
pub fn run(ports: &Ports, settings: &Settings, stop: &Stop) -> Result<(), GatewayError> {
    let mut pulse = Pulse::new(ports, Participant::Gateway)?.exposed(settings.run.exposure);
    let rates = settings.rates.of(settings.run.exposure);
    let mut relay = Relay::open(ports, &rates)?;
    let (mut publisher, place) = publisher(settings)?;
    let mut page = page(settings)?;
    // A restarted gateway skips this test: its endpoints have been tested, and watchers wait for
    // them.
    if let Some(credentials) =
        settings.telemetry.credentials.as_ref().filter(|_| place == Place::New)
    {
        publisher.self_test(credentials, pulse.health())?;
        tracing::info!("the telemetry rejects unauthenticated peers");
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
            answers.look().iter().for_each(|settled| page.feed().receive_change(settled));
            page.turn(Instant::now());
        }
        relay.count(&mut pulse);
        pulse.beat();
        // Messages that arrive meanwhile are processed together.
        thread::sleep(breath);
    }
    pulse.last_words(Phase::Finished, settings.run.pace);
    Ok(publisher.close()?)
}

/// Whether the endpoints are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// A previous gateway listened here.
    Known,
    /// The endpoints are new.
    New,
}

/// Listens on the previous endpoints after a restart, so that watchers find it again; else on those
/// in the settings.
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

/// Publishes the endpoints to watchers on this machine.
fn welcome(settings: &Settings, endpoints: &[String]) {
    // Written before the log line: its reader may look there at once.
    if let Err(error) = addresses::note(&settings.run.links.root, endpoints) {
        tracing::warn!(%error, "the endpoints could not be recorded for watchers on this machine");
    }
    tracing::info!(
        robot = %settings.telemetry.robot,
        endpoints = %endpoints.join(", "),
        "watchers may connect"
    );
}

/// Serves the live page at its previous address after a restart, so that open pages reconnect; else
/// at the address in the settings.
fn page(settings: &Settings) -> Result<Option<Page>, PageError> {
    let root = &settings.run.links.root;
    let page = Page::open(settings, addresses::page(root))?;
    if let Some(page) = &page {
        let address = page.address();
        tracing::info!(%address, "the live page is served");
        if let Err(error) = addresses::note_page(root, address) {
            tracing::warn!(%error, "the address of the live page could not be recorded");
        }
    }
    Ok(page)
}

/// Relays of all topics to the watchers.
struct Relay {
    states: TopicRelay<PlantState>,
    /// The gateway sleeps on this topic. The plan is published after the command, so that no
    /// wake-up disturbs the computation of an answer.
    plans: TopicRelay<Plan>,
    healths: KindsRelay<Health, { Participant::ALL.len() }>,
    residuals: TopicRelay<ResidualSample>,
    snapshots: TopicRelay<ModelSnapshot>,
    truths: TopicRelay<Truth>,
    goals: TopicRelay<Goal>,
    obstacles: KindsRelay<Obstacles, { ObstacleSource::ALL.len() }>,
}

impl Relay {
    fn open(ports: &Ports, rates: &Rates) -> Result<Self, OpenError> {
        Ok(Self {
            states: TopicRelay::open(ports, rates.state)?,
            plans: TopicRelay::open(ports, rates.plan)?,
            healths: KindsRelay::open(ports, rates.health, |health: &Health| health.participant)?,
            residuals: TopicRelay::open(ports, rates.residual)?,
            snapshots: TopicRelay::open(ports, rates.snapshot)?,
            truths: TopicRelay::open(ports, rates.truth)?,
            goals: TopicRelay::open(ports, rates.goal)?,
            obstacles: KindsRelay::open(ports, rates.obstacles, |list: &Obstacles| list.source)?,
        })
    }

    /// The state is sent before the plan that answers it.
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
                page.receive_health(health, now);
            }
        })?;
        self.residuals.pass(now, publisher)?;
        let snapshot = self.snapshots.pass(now, publisher)?;
        self.truths.pass(now, publisher)?;
        let goal = self.goals.pass(now, publisher)?;
        self.obstacles.pass(now, publisher, |list| {
            if let Some(page) = &mut page {
                page.receive_obstacles(list, now);
            }
        })?;
        if let Some(page) = page {
            if let Some(state) = &state {
                page.receive_state(state);
            }
            if let Some(plan) = &plan {
                page.receive_plan(plan);
            }
            if let Some(goal) = &goal {
                page.receive_goal(goal);
            }
            if let Some(snapshot) = &snapshot {
                page.receive_snapshot(snapshot);
            }
        }
        Ok(())
    }

    /// Messages that a passive subscriber skipped are not lost.
    fn count(&self, pulse: &mut Pulse) {
        for (topic, tally) in [
            (Topic::State, self.states.tally()),
            (Topic::Plan, self.plans.tally()),
            (Topic::Health, self.healths.tally()),
            (Topic::Residual, self.residuals.tally()),
            (Topic::Snapshot, self.snapshots.tally()),
            (Topic::Truth, self.truths.tally()),
            (Topic::Goal, self.goals.tally()),
            (Topic::Obstacles, self.obstacles.tally()),
        ] {
            pulse.count_source(topic, Tally { lost: 0, ..tally });
        }
    }
}
