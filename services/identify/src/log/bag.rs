//! A bag of ROS 2 (MCAP or sqlite3) → samples.
//!
//! | module        | contents                                                          |
//! |---------------|-------------------------------------------------------------------|
//! | `error`       | why a bag cannot be read                                          |
//! | `files`       | which files there are, and what they contain                      |
//! | `mcap_file`   | an MCAP file                                                      |
//! | `sqlite_file` | a sqlite3 file                                                    |
//! | `ros`         | messages (CDR) → numbers                                          |
//! | `messages`    | the messages of the topics that are used                          |
//! | `series`      | values at times at which there was no message                     |
//! | `samples`     | all of them at a constant period                                  |
//!
//! **Times.** Odometry, command and joints have times and rates of their own. A message counts at
//! the time of its header; one without a header, or with a header of time zero, at the time at
//! which it was recorded. The period is the median step of the odometry. Samples are a whole number
//! of periods after the first odometry message, and after each gap.
//!
//! **Measurements** are on the line between the two messages around the time of the sample. The
//! nearest message would be up to half a period away from it, and the estimate of the dead time
//! would be wrong by as much. Where the odometry has a constant step, the samples are its messages.
//!
//! **Input** of a sample is the mean, over the period that ends with it, of commands that each hold
//! until the next one. So a command that comes between two samples counts by its time, and a dead
//! time of a part of the period can be found.

mod error;
mod files;
mod mcap_file;
mod messages;
mod ros;
mod samples;
mod series;
mod sqlite_file;

use super::{Log, LogError};
use clap::Args;
use files::Topic;
use messages::Messages;
use std::path::Path;

pub use error::BagError;
pub(super) use files::is_bag;
pub use ros::MessageError;

const ODOMETRY: &str = "nav_msgs/msg/Odometry";
const TWIST: &str = "geometry_msgs/msg/Twist";
const TWIST_STAMPED: &str = "geometry_msgs/msg/TwistStamped";
const JOINTS: &str = "sensor_msgs/msg/JointState";

/// Which topics of a bag are read.
#[derive(Debug, Clone, Default, Args)]
pub struct Topics {
    /// In a ROS 2 bag: topic of the odometry (default: the only nav_msgs/msg/Odometry).
    #[arg(long, value_name = "TOPIC")]
    pub odometry: Option<String>,
    /// In a ROS 2 bag: topic of the commanded body velocity (default: the only Twist or
    /// TwistStamped of geometry_msgs).
    #[arg(long, value_name = "TOPIC")]
    pub command: Option<String>,
    /// In a ROS 2 bag: joints of the wheels, in the order of the robot file. Without it wheel
    /// speeds are not read.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub wheel_joints: Vec<String>,
    /// In a ROS 2 bag: topic of these joints (default: the only sensor_msgs/msg/JointState).
    #[arg(long, value_name = "TOPIC", requires = "wheel_joints")]
    pub joints: Option<String>,
}

/// The topics that are used.
struct Chosen {
    odometry: Topic,
    command: Topic,
    joints: Option<Topic>,
}

pub(super) fn read(path: &Path, topics: &Topics) -> Result<Log, LogError> {
    let files = files::files(path)?;
    let chosen = topics.of(path, &files::topics(&files)?)?;
    let mut messages = Messages::new(&chosen, &topics.wheel_joints);
    let mut early = Vec::new();
    for file in &files {
        if files::messages(file, &chosen.names(), &mut |message| messages.take(file, message))? {
            early.push(format!("{} ends early", file.display()));
        }
    }
    let mut log = samples::log(path, &messages.read(path)?, topics.wheel_joints.len())?;
    log.notes.extend(early);
    Ok(log)
}

impl Topics {
    fn of(&self, path: &Path, topics: &[Topic]) -> Result<Chosen, BagError> {
        let choose = |kinds: &[&str], option, wanted: &Option<String>| {
            choose(path, topics, kinds, option, wanted.as_deref())
        };
        Ok(Chosen {
            odometry: choose(&[ODOMETRY], "odometry", &self.odometry)?,
            command: choose(&[TWIST, TWIST_STAMPED], "command", &self.command)?,
            joints: if self.wheel_joints.is_empty() {
                None
            } else {
                Some(choose(&[JOINTS], "joints", &self.joints)?)
            },
        })
    }
}

/// The topic `wanted`, or without it the only one of `kinds`.
fn choose(
    path: &Path,
    topics: &[Topic],
    kinds: &[&str],
    option: &'static str,
    wanted: Option<&str>,
) -> Result<Topic, BagError> {
    let is_possible = |topic: &&Topic| {
        kinds.contains(&topic.kind.as_str()) && wanted.is_none_or(|name| name == topic.name)
    };
    let possible: Vec<&Topic> = topics.iter().filter(is_possible).collect();
    let [topic] = possible[..] else {
        let listed = topics.iter().map(|topic| (topic.name.clone(), topic.kind.clone()));
        return Err(BagError::Topic {
            path: path.to_owned(),
            count: possible.len(),
            kinds: kinds.join(" or "),
            option,
            topics: listed.collect(),
        });
    };
    if topic.encoding != "cdr" {
        let (path, topic, encoding) = (path.to_owned(), topic.name.clone(), topic.encoding.clone());
        return Err(BagError::Encoding { path, topic, encoding });
    }
    Ok(topic.clone())
}

impl Chosen {
    fn names(&self) -> Vec<&str> {
        let topics = [Some(&self.odometry), Some(&self.command), self.joints.as_ref()];
        topics.into_iter().flatten().map(|topic| topic.name.as_str()).collect()
    }
}
