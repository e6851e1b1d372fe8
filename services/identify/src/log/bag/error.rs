//! Why a bag cannot be read.

use super::ros::MessageError;
use std::path::PathBuf;

/// Why a bag cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// It is compressed as a whole.
    #[error("{}: the file is compressed: decompress it first with `zstd -d`", .0.display())]
    Compressed(PathBuf),
    /// A file in its folder is of another kind.
    #[error("{}: expected a bag of ROS 2 (MCAP or sqlite3)", .0.display())]
    Foreign(PathBuf),
    /// An MCAP file is damaged, or compressed by another method than LZ4 and Zstandard.
    #[error("{}: {source}", path.display())]
    Mcap {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: mcap::McapError,
    },
    /// A sqlite3 file is damaged, or of another kind.
    #[error("{}: {source}", path.display())]
    Database {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: rusqlite::Error,
    },
    /// A sqlite3 file that rosbag2 does not write.
    #[error("{}: expected the tables \"topics\" and \"messages\" of rosbag2", .0.display())]
    Tables(PathBuf),
    /// No topic, or several that are possible.
    #[error(
        "{}: {count} topics of type {kinds}: expected one, or --{option} TOPIC; there are: {}",
        path.display(),
        listed(topics)
    )]
    Topic {
        /// The bag.
        path: PathBuf,
        /// Number of topics that are possible.
        count: usize,
        /// Their types.
        kinds: String,
        /// The option that chooses one.
        option: &'static str,
        /// Name and type of each topic with messages.
        topics: Vec<(String, String)>,
    },
    /// A topic is not in CDR.
    #[error("{}: topic {topic:?} has the encoding {encoding:?}: expected \"cdr\"", path.display())]
    Encoding {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its encoding.
        encoding: String,
    },
    /// A message cannot be used.
    #[error("{}: message {number} of topic {topic:?}: {source}", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Number of the message within its topic in this bag, from 1.
        number: u64,
        /// The cause.
        source: MessageError,
    },
    /// A message was recorded at an impossible time.
    #[error(
        "{}: a message of topic {topic:?} was recorded at {nanos} ns: expected a time from 1970 to \
         2100",
        path.display()
    )]
    LogTime {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The time \[ns\].
        nanos: i64,
    },
    /// Command and odometry have the times of different clocks.
    #[error(
        "{}: topic {topic:?} has no times of its own, and the odometry was recorded {late_s:.3} s \
         after the time of its header: expected -0.05 to 0.5 s; record on the robot, with the same \
         clock (--use-sim-time if the robot is simulated), or publish the command as TwistStamped",
        path.display()
    )]
    Clocks {
        /// The bag.
        path: PathBuf,
        /// The topic of the command.
        topic: String,
        /// Median time from header to recording \[s\].
        late_s: f64,
    },
    /// No message has the joints of the wheels.
    #[error(
        "{}: no message of topic {topic:?} has all wheel joints {}; there are: {}",
        path.display(),
        wanted.join(", "),
        found.join(", ")
    )]
    Joints {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The wheel joints.
        wanted: Vec<String>,
        /// Joints of the last message.
        found: Vec<String>,
    },
}

fn listed(topics: &[(String, String)]) -> String {
    if topics.is_empty() {
        return "none".to_owned();
    }
    let topics: Vec<String> =
        topics.iter().map(|(name, kind)| format!("{name:?} ({kind})")).collect();
    topics.join(", ")
}
