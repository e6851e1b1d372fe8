//! Lists of obstacles for a robot while it drives, from a planner: a program that sees what the
//! robot does not.

use crate::set::{SetError, launch};
use access::Credentials;
use driver::{ImpossiblePlannerList, PlannerList};
use network::requests::{RequestError, Requester};
use process::lists::{Lists, Verdict};
use protocol::message::Participant;
use std::io;
use std::path::Path;

/// A list does not act.
#[derive(Debug, thiserror::Error)]
pub enum ObstaclesError {
    /// No launch runs, or more than one.
    #[error(transparent)]
    Launch(#[from] SetError),
    /// The list is impossible.
    #[error(transparent)]
    List(#[from] ImpossiblePlannerList),
    /// It cannot be written as JSON.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The plant of this machine cannot be reached.
    #[error("no plant accepts lists of obstacles on this machine: {0}")]
    Plant(#[source] io::Error),
    /// The plant of this machine rejects the list.
    #[error("rejected by the plant: {reason}")]
    Rejected {
        /// Why.
        reason: String,
    },
    /// The plant of another machine cannot be reached, or rejects the list.
    #[error(transparent)]
    Network(#[from] RequestError),
}

/// Sends lists of obstacles to the plant of one launch. Send one several times within its validity:
/// when the newest list is too old, the robot slows down, also if the program has ended.
///
/// ```no_run
/// use coxswain::obstacles::ObstacleLists;
/// use driver::{Listed, PlannerList};
/// use runs::registry;
///
/// let disc = Listed { corners_m: vec![[2.0, 0.5]], radius_m: 0.3, velocity_mps: [0.0; 2] };
/// let list = PlannerList { valid_s: 0.5, age_s: 0.0, obstacles: vec![disc] };
/// ObstacleLists::on_this_machine(None, &registry::base())?.send(&list)?;
/// # Ok::<(), coxswain::obstacles::ObstaclesError>(())
/// ```
pub struct ObstacleLists(Way);

/// The way to the plant.
enum Way {
    Machine(Lists),
    Network(Box<Requester>),
}

impl ObstacleLists {
    /// For a launch on this machine: that with the run directory `run`, or the only one that runs.
    /// `base` is the directory of the running graphs, [`runs::registry::base`].
    ///
    /// # Errors
    /// [`ObstaclesError::Launch`] if there is no such launch.
    pub fn on_this_machine(run: Option<&Path>, base: &Path) -> Result<Self, ObstaclesError> {
        let (entry, _) = launch(run, base)?;
        Ok(Self(Way::Machine(Lists::new(&entry.root()))))
    }

    /// For a launch whose plant runs at another machine, which accepts requests at `endpoint`, such
    /// as `tls/10.0.0.1:7451`. `credentials` are those of a planner. Call
    /// [`network::threads::set`] first of all.
    ///
    /// # Errors
    /// [`ObstaclesError::Network`], within seconds.
    pub fn over_network(endpoint: &str, credentials: &Credentials) -> Result<Self, ObstaclesError> {
        Ok(Self(Way::Network(Box::new(Requester::open(endpoint, credentials)?))))
    }

    /// Sends a list, and waits until the plant has accepted it.
    ///
    /// # Errors
    /// [`ObstaclesError`]; no part of the list acts then.
    pub fn send(&mut self, list: &PlannerList) -> Result<(), ObstaclesError> {
        list.message()?;
        let text = serde_json::to_string(list)?;
        match &mut self.0 {
            Way::Machine(lists) => match lists.send(&text).map_err(ObstaclesError::Plant)? {
                Verdict::Accepted => Ok(()),
                Verdict::Rejected { reason } => Err(ObstaclesError::Rejected { reason }),
            },
            Way::Network(requester) => {
                requester.ask(Participant::Plant, &text)?;
                Ok(())
            }
        }
    }
}
