//! The way of the keys to a launch: files and shared memory on its own machine, queries to its
//! bridge from another one.

use crate::joined::{JoinError, Joined};
use crate::set::{Recipient, SetError, request};
use network::requests::{RequestError, Requester};
use process::requests::{Asked, Outcome, Settlement};
use protocol::message::{GateState, Goal, Participant, PlantState};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};
use transport::Source;

/// Interval between two checks whether the launch still runs.
const CHECK: Duration = Duration::from_millis(200);

/// A way to one launch.
pub(super) enum Way {
    /// The launch runs on this machine.
    Machine(Box<Machine>),
    /// It runs on another one.
    Network(Network),
}

/// A launch of this machine, and what it does.
pub(super) struct Machine {
    joined: Joined,
    goals: Source<Goal>,
    states: Source<PlantState>,
    goal: Option<Goal>,
    state: Option<PlantState>,
    checked: Instant,
}

/// Sessions with the bridge of the controller's host, and with that of the plant's.
pub(super) struct Network {
    controller: Arc<Requester>,
    plant: Arc<Requester>,
}

/// A request that has no reply yet.
pub(super) enum Awaited {
    /// In a file.
    File(Asked),
    /// On a thread, which waits for the network.
    Query(Receiver<Reply>),
}

/// What has become of a request.
pub(super) enum Reply {
    /// The process has decided.
    Outcome(Outcome),
    /// It is not known, for this reason.
    Unknown(String),
}

impl Way {
    /// To the launch in the run directory `run`, or to the only one that runs, with the graphs of
    /// this machine in `base`.
    ///
    /// # Errors
    /// [`JoinError`].
    pub(super) fn on_this_machine(
        run: Option<&Path>,
        base: &Path,
        now: Instant,
    ) -> Result<Self, JoinError> {
        let joined = Joined::new(run, base)?;
        let (goals, states) = (joined.watcher()?, joined.watcher()?);
        let machine = Machine { joined, goals, states, goal: None, state: None, checked: now };
        Ok(Self::Machine(Box::new(machine)))
    }

    /// To the launch that `to` names, with the bridge of its plant at `plant_at` if that is another
    /// one; none if `to` names no address.
    ///
    /// # Errors
    /// [`SetError`] if a bridge accepts no session.
    pub(super) fn over_network(
        to: &Recipient,
        plant_at: Option<&str>,
    ) -> Result<Option<Self>, SetError> {
        let Some(controller) = to.requester(None)?.map(Arc::new) else { return Ok(None) };
        let plant = match plant_at {
            Some(_) => to.requester(plant_at)?.map(Arc::new),
            None => None,
        };
        let plant = plant.unwrap_or_else(|| Arc::clone(&controller));
        Ok(Some(Self::Network(Network { controller, plant })))
    }

    /// Requests `lines` from the process `of`.
    ///
    /// # Errors
    /// [`SetError`] if the request cannot be written.
    pub(super) fn ask(&self, of: Participant, lines: String) -> Result<Awaited, SetError> {
        let requester = match self {
            Self::Machine(machine) => {
                return request(&machine.joined.folder, of, &lines).map(Awaited::File);
            }
            Self::Network(network) if of == Participant::Plant => &network.plant,
            Self::Network(network) => &network.controller,
        };
        let requester = Arc::clone(requester);
        let (sender, reply) = sync_channel(1);
        let ask = move || sender.send(replied(&requester, of, &lines));
        thread::Builder::new().spawn(ask).map_err(SetError::Thread)?;
        Ok(Awaited::Query(reply))
    }

    /// Takes the messages of the launch.
    ///
    /// # Errors
    /// [`JoinError`] if it has ended.
    pub(super) fn look(&mut self, now: Instant) -> Result<(), JoinError> {
        let Self::Machine(machine) = self else { return Ok(()) };
        if now.saturating_duration_since(machine.checked) >= CHECK {
            machine.joined.check()?;
            machine.checked = now;
        }
        machine.goal = machine.goals.latest()?.or(machine.goal);
        machine.state = machine.states.latest()?.or(machine.state);
        Ok(())
    }

    /// Whether a reply may still come.
    pub(super) fn may_reply(&self) -> bool {
        match self {
            Self::Machine(machine) => machine.joined.check().is_ok(),
            Self::Network(_) => true,
        }
    }

    /// Whether the gate is known to be stopped.
    pub(super) fn is_stopped(&self) -> bool {
        match self {
            Self::Machine(machine) => machine.gate() == Some(GateState::Stopped),
            Self::Network(_) => false,
        }
    }

    /// Robot, gate and goal in one line; none if they are not known here.
    pub(super) fn line(&self) -> Option<String> {
        match self {
            Self::Machine(machine) => Some(machine.line()),
            Self::Network(_) => None,
        }
    }
}

impl Machine {
    fn gate(&self) -> Option<GateState> {
        self.state.as_ref().map(PlantState::gate)
    }

    fn line(&self) -> String {
        let velocity = |state: PlantState| super::steering::triple(state.velocity);
        let robot = self.state.map_or_else(|| "unknown".to_owned(), velocity);
        let gate = self.gate().map_or("unknown", |gate| gate.text());
        let goal = self.goal.map_or_else(
            || "no goal".to_owned(),
            |goal| format!("goal {} {}", goal.id, goal.phase()),
        );
        format!("robot {robot}; {gate}; {goal}")
    }
}

impl Awaited {
    /// The reply, once it is there.
    pub(super) fn reply(&self) -> Option<Reply> {
        match self {
            Self::File(asked) => Some(Reply::Outcome(asked.answer()?.answer.outcome)),
            Self::Query(reply) => match reply.try_recv() {
                Ok(reply) => Some(reply),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => Some(Reply::Unknown("no reply".to_owned())),
            },
        }
    }
}

/// Sends a request, and waits for its reply.
fn replied(requester: &Requester, of: Participant, lines: &str) -> Reply {
    let reply = match requester.ask(of, lines) {
        Ok(reply) => reply,
        Err(RequestError::Rejected(reason)) => {
            return Reply::Outcome(Outcome::Refused { code: String::new(), reason });
        }
        Err(error) => return Reply::Unknown(error.to_string()),
    };
    match serde_json::from_slice(&reply) {
        Ok(Settlement { answer, .. }) => Reply::Outcome(answer.outcome),
        Err(error) => Reply::Unknown(error.to_string()),
    }
}
