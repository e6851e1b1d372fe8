//! The messages of the topics that are used → series in the order of time.

use super::files::{Recorded, Topic};
use super::ros::{self, MessageError, Stamped};
use super::series::{Point, Series};
use super::{BagError, Chosen, TWIST};
use crate::log::LogError;
use robot::{AXES, WHEELS_MAX};
use std::ops::RangeInclusive;
use std::path::Path;

/// Pose and velocity.
pub(super) const STATE: usize = 2 * AXES;

/// Median time from the header of the odometry to its recording that one clock can show \[ns\].
const LATE_NANOS: RangeInclusive<i64> = -50_000_000..=500_000_000;

/// Times at which a message can be recorded: 1970 to 2100 \[ns\].
const RECORDED_NANOS: RangeInclusive<i64> = 0..=4_102_444_800_000_000_000;

/// Collects the messages.
pub(super) struct Messages<'bag> {
    chosen: &'bag Chosen,
    wheel_joints: &'bag [String],
    odometry: Collected<STATE>,
    command: Collected<AXES>,
    joints: Collected<WHEELS_MAX>,
    /// Joints of the last message.
    found_joints: Vec<String>,
}

/// Series of all topics.
pub(super) struct Read {
    pub(super) odometry: Series<STATE>,
    pub(super) command: Series<AXES>,
    /// If wheel speeds are to be read.
    pub(super) wheels: Option<Series<WHEELS_MAX>>,
    /// Topic of the odometry.
    pub(super) topic: String,
    /// What was left out, by place.
    pub(super) notes: Vec<(String, String)>,
}

/// Messages of one topic, in the order of the bag.
#[derive(Default)]
struct Collected<const N: usize> {
    messages: Vec<Message<N>>,
    /// Number of messages, also of those that are left out.
    count: u64,
    notes: Vec<(String, String)>,
}

#[derive(Clone, Copy)]
struct Message<const N: usize> {
    point: Point<N>,
    recorded_nanos: i64,
    has_time: bool,
}

impl<'bag> Messages<'bag> {
    pub(super) fn new(chosen: &'bag Chosen, wheel_joints: &'bag [String]) -> Self {
        Self {
            chosen,
            wheel_joints,
            odometry: Collected::default(),
            command: Collected::default(),
            joints: Collected::default(),
            found_joints: Vec::new(),
        }
    }

    /// Takes a message of `file`.
    pub(super) fn take(&mut self, file: &Path, message: &Recorded<'_>) -> Result<(), LogError> {
        if !RECORDED_NANOS.contains(&message.nanos) {
            let (path, topic) = (file.to_owned(), message.topic.to_owned());
            return Err(BagError::LogTime { path, topic, nanos: message.nanos }.into());
        }
        let Chosen { odometry, command, joints } = self.chosen;
        let is_of = |topic: &Topic| topic.name == message.topic;
        if is_of(odometry) {
            let decoded = ros::odometry(message.bytes);
            self.odometry.add_or_note(file, message, decoded)?;
        } else if is_of(command) {
            let decode = if command.kind == TWIST { ros::twist } else { ros::twist_stamped };
            self.command.add(file, message, decode(message.bytes))?;
        } else if joints.as_ref().is_some_and(is_of) {
            let decoded = self.wheels(message.bytes);
            self.joints.add_some(file, message, decoded)?;
        }
        Ok(())
    }

    /// Speeds of the wheels; none if the message does not have all of them.
    fn wheels(&mut self, bytes: &[u8]) -> Result<Option<Stamped<[f64; WHEELS_MAX]>>, MessageError> {
        let Stamped { nanos, value: joints } = ros::joints(bytes)?;
        let mut value = [0.0; WHEELS_MAX];
        for (speed, wheel) in value.iter_mut().zip(self.wheel_joints) {
            let Some((_, found)) = joints.iter().find(|(name, _)| name == wheel) else {
                self.found_joints = joints.into_iter().map(|(name, _)| name).collect();
                return Ok(None);
            };
            *speed = *found;
        }
        Ok(Some(Stamped { nanos, value }))
    }

    /// All messages, in the order of their times.
    pub(super) fn read(self, path: &Path) -> Result<Read, LogError> {
        let Chosen { odometry, command, joints } = self.chosen;
        if let Some(joints) = joints
            && self.joints.messages.is_empty()
        {
            return Err(BagError::Joints {
                path: path.to_owned(),
                topic: joints.name.clone(),
                wanted: self.wheel_joints.to_vec(),
                found: self.found_joints,
            }
            .into());
        }
        if command.kind == TWIST {
            self.odometry.check_clock(path, &command.name)?;
        }
        let mut notes = Vec::new();
        Ok(Read {
            odometry: self.odometry.series(path, &odometry.name, &mut notes)?,
            command: self.command.series(path, &command.name, &mut notes)?,
            wheels: joints
                .as_ref()
                .map(|joints| self.joints.series(path, &joints.name, &mut notes))
                .transpose()?,
            topic: odometry.name.clone(),
            notes,
        })
    }
}

impl<const N: usize> Collected<N> {
    /// Adds a message. One without a position or velocity is left out, as a gap: some drivers begin
    /// with such messages.
    fn add_or_note(
        &mut self,
        file: &Path,
        message: &Recorded<'_>,
        decoded: Result<Stamped<[f64; N]>, MessageError>,
    ) -> Result<(), LogError> {
        match decoded {
            Err(error @ (MessageError::NotFinite(_) | MessageError::Quaternion(_))) => {
                self.count += 1;
                self.notes.push((place(message.topic, self.count), format!("{error}, left out")));
                Ok(())
            }
            decoded => self.add(file, message, decoded),
        }
    }

    fn add(
        &mut self,
        file: &Path,
        message: &Recorded<'_>,
        decoded: Result<Stamped<[f64; N]>, MessageError>,
    ) -> Result<(), LogError> {
        self.add_some(file, message, decoded.map(Some))
    }

    fn add_some(
        &mut self,
        file: &Path,
        message: &Recorded<'_>,
        decoded: Result<Option<Stamped<[f64; N]>>, MessageError>,
    ) -> Result<(), LogError> {
        self.count += 1;
        let number = self.count;
        let decoded = decoded.map_err(|source| BagError::Message {
            path: file.to_owned(),
            topic: message.topic.to_owned(),
            number,
            source,
        })?;
        if let Some(Stamped { nanos, value }) = decoded {
            let recorded_nanos = message.nanos;
            let point = Point { nanos: nanos.unwrap_or(recorded_nanos), number, value };
            self.messages.push(Message { point, recorded_nanos, has_time: nanos.is_some() });
        }
        Ok(())
    }

    /// Fails if the times of the headers and those of the recording are those of different clocks.
    fn check_clock(&self, path: &Path, topic: &str) -> Result<(), BagError> {
        let late = |message: &Message<N>| message.recorded_nanos - message.point.nanos;
        let mut late: Vec<i64> = self.messages.iter().map(late).collect();
        late.sort_unstable();
        match late.get(late.len() / 2) {
            Some(median) if !LATE_NANOS.contains(median) => Err(BagError::Clocks {
                path: path.to_owned(),
                topic: topic.to_owned(),
                late_s: *median as f64 * 1e-9,
            }),
            _ => Ok(()),
        }
    }

    /// The messages as they were recorded, which must be the order of their times. Of several with
    /// one time the last one counts.
    fn series(
        mut self,
        path: &Path,
        topic: &str,
        notes: &mut Vec<(String, String)>,
    ) -> Result<Series<N>, LogError> {
        notes.append(&mut self.notes);
        self.messages.sort_by_key(|message| message.recorded_nanos);
        let without = self.messages.iter().filter(|message| !message.has_time).count();
        if without > 0 && self.messages.iter().any(|message| message.has_time) {
            notes.push((format!("{topic:?}"), format!("{without} messages without a time")));
        }
        let mut points: Vec<Point<N>> = Vec::with_capacity(self.messages.len());
        for Message { point, .. } in self.messages {
            if let Some(last) = points.last_mut() {
                if point.nanos < last.nanos {
                    return Err(LogError::Backwards {
                        place: format!("{} {}", path.display(), place(topic, point.number)),
                        time_s: point.nanos as f64 * 1e-9,
                        before_s: last.nanos as f64 * 1e-9,
                    });
                }
                if point.nanos == last.nanos {
                    notes.push((
                        place(topic, last.number),
                        "the time of the next message, left out".to_owned(),
                    ));
                    *last = point;
                    continue;
                }
            }
            points.push(point);
        }
        Ok(Series::new(points))
    }
}

/// Where a message is.
pub(super) fn place(topic: &str, number: u64) -> String {
    format!("topic {topic:?}, message {number}")
}
