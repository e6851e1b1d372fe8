//! Obstacles that appear before, beside or on a robot that drives.
//!
//! | rule    | what must hold                                                                  |
//! |---------|---------------------------------------------------------------------------------|
//! | stops   | one that appears farther away than the robot needs to stop is not touched       |
//! | brakes  | while one touches the footprint, the ramp of the brake ends each motion towards |
//! |         | it; from then on a command that leads towards it is a ramp that ends, and the   |
//! |         | robot gets no deeper into it once it rests                                      |
//! | slows   | where the gate slows the robot, no axis gets faster than it was and was sent    |
//! | leaves  | a robot that moves and is commanded straight away from it is not slowed: at     |
//! |         | most 45° beside −n, and without a turn. The gate has to expect more of others.  |
//! |         | A robot that was slowed before needs some periods to its full speed             |
//! | resumes | when they are gone, the robot reaches its goal                                  |
//!
//! n is the unit vector from the footprint to the obstacle. The closing speed of a body velocity is
//! the largest one of all corners of the footprint along n.

use super::goals::planner::{Planner, tell};
use super::goals::{DURATION_S, conclude};
use super::measure::{Measured, is_slowed};
use super::oracle::{Limits, commanded};
use super::record::{Message, Record};
use super::session::{Home, Session, Trouble};
use process::{Stop, Witness};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use robot::{Obstacle, Robot, Shape, Velocity};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::{Duration, Instant};

/// Time of the first one, and between two of them \[s\].
const EVERY_S: f64 = 3.0;
/// How long each one stays \[ms\].
const STAYS_MILLIS: u64 = 1500;
/// Where the robot drives to and fro \[m\], and its largest speed.
const FAR_M: f64 = 2.0;
const SPEED_MPS: &str = "1.5";
/// Closing speed that counts as none: the normal turns while the robot moves \[m/s\].
const SLACK_MPS: f64 = 0.02;
/// Way deeper into an obstacle that counts as none \[m\].
const DEEPER_M: f64 = 0.005;
/// Rounding \[m/s, rad/s\].
const ROUNDING: f64 = 1e-5;
/// Closing speed of a robot that leaves, at most \[m/s\].
const LEAVES_MPS: f64 = -0.1;
/// Largest turn of such a robot \[rad/s\].
const LEAVES_RADPS: f64 = 0.3;
/// Periods between an obstacle and the last one that its ramp begins in.
const RAMP_PERIODS: u64 = 3;
/// Response times after which the rest of an earlier motion is small.
const LAGS: f64 = 4.0;
/// Periods in which a robot that was slowed gets its full speed back.
const RELEASE_PERIODS: u64 = 3;

/// Faults of `times` obstacles around a robot that drives along x.
pub(super) fn faults(times: u32, seed: u64) -> String {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut text = String::new();
    for index in 0..times {
        let side = if random.random() { 1.0 } else { -1.0 };
        let (ahead, left) = match index % 4 {
            // Before or behind it, within and beyond the way that it needs to stop.
            0 => (side * random.random_range(0.3..1.2), random.random_range(-0.2..0.2)),
            // On one end of it.
            1 => (side * random.random_range(0.1..0.3), random.random_range(-0.1..0.1)),
            // Beside it.
            2 => (random.random_range(-0.1..0.1), side * random.random_range(0.25..0.5)),
            // In its middle.
            _ => (random.random_range(-0.05..0.05), random.random_range(-0.05..0.05)),
        };
        let (radius, phase) = (random.random_range(0.05..0.2), random.random_range(0.0..0.8));
        let from_s = EVERY_S * f64::from(index + 1) + phase;
        let _ = write!(
            text,
            "[[plant]]\nkind = \"obstacle\"\nfrom_s = {from_s:.4}\nmillis = {STAYS_MILLIS}\n\
             at_m = [{ahead:.4}, {left:.4}]\nradius_m = {radius:.4}\n"
        );
    }
    text
}

/// Drives to and fro while `times` obstacles appear.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn run(home: &Home<'_>, times: u32, stop: &Stop) -> Result<Measured, Trouble> {
    let witness = Witness::begin();
    let mut session = home.launch("run", DURATION_S)?;
    session.wait_for_log("controller", "answering a plant", 1)?;
    let mut measured = Measured::default();
    drive(home, &session, EVERY_S * f64::from(times + 1) + 2.0, stop)?;
    if tell(home, &session, &["go", "0", "0", "0"], stop)? != Some(0) {
        measured.violations.push("the robot reaches no goal when they are gone".to_owned());
    }
    let record = conclude(home, &mut session, witness, true, &mut measured)?;
    let found = judge(&record, &home.assembly()?.robot, &home.limits()?)?;
    measured.injections = found.moving;
    measured.notes.push(format!(
        "{} of {times} appeared while the robot moved, {} touched it, {} periods were slowed",
        found.moving, found.touched, found.slowed
    ));
    measured.violations.extend(found.violations);
    if found.moving == 0 || found.slowed == 0 {
        measured.violations.push("none was in the way: the exercise shows nothing".to_owned());
    }
    Ok(measured)
}

/// Drives to and fro for `seconds`. A goal may be rejected while an obstacle is on the robot.
fn drive(home: &Home<'_>, session: &Session, seconds: f64, stop: &Stop) -> Result<(), Trouble> {
    let begin = Instant::now();
    let mut to = FAR_M;
    while begin.elapsed() < Duration::from_secs_f64(seconds) && !stop.requested() {
        let place = to.to_string();
        let arguments = ["go", &place, "0", "0", "--speed", SPEED_MPS];
        let mut planner = Planner::start(home, session, "planner", &arguments)?;
        if planner.exit_code(stop)? == Some(0) {
            to = -to;
        }
    }
    Ok(())
}

/// What an exercise has shown.
#[derive(Debug, Default)]
struct Found {
    /// Obstacles that appeared while the robot moved.
    moving: u64,
    /// Obstacles that touched its footprint with the clearance.
    touched: u64,
    /// Periods in which the gate slowed the robot.
    slowed: u64,
    violations: Vec<String>,
}

/// The messages of one period.
struct Period<'a> {
    tick: u64,
    /// Truth at its begin, and at its end.
    truths: [&'a Message; 2],
    /// States at its begin, and at its end.
    states: [&'a Message; 2],
    obstacle: Obstacle,
}

/// How the footprint touches an obstacle.
#[derive(Debug, Clone, Copy)]
struct Touch {
    /// Tick at which the ramp of the present motion has ended.
    ends: u64,
    /// Tick at which the robot rests.
    rests: u64,
    /// Least distance until then \[m\].
    least_m: f64,
}

/// Since when one obstacle is there.
#[derive(Debug, Clone, Copy)]
struct There {
    /// Its first tick.
    since: u64,
    /// Whether the robot can stop before it.
    is_far: bool,
    touch: Option<Touch>,
    has_touched: bool,
    /// Number of periods in a row in which the robot left it, but was slowed.
    slowed_periods: u64,
}

fn judge(record: &Record, robot: &Robot, limits: &Limits) -> Result<Found, Trouble> {
    let by_tick = |topic| -> BTreeMap<u64, &Message> {
        record.of(topic).map(|message| (message.stamp("tick"), message)).collect()
    };
    let (truths, states, commands) = (by_tick("truth"), by_tick("state"), by_tick("command"));
    let lists = by_tick("obstacles");
    let (mut found, mut there): (Found, Option<There>) = (Found::default(), None);
    for (&tick, list) in &lists {
        // One obstacle is there at a time.
        let Some(obstacle) = listed(list)?.pop() else {
            there = None;
            continue;
        };
        let (Some(truths), Some(states)) = (at_both(&truths, tick), at_both(&states, tick)) else {
            continue;
        };
        let period = Period { tick, truths, states, obstacle };
        there = Some(period.judge(there, robot, limits, &asked(&commands, tick)?, &mut found)?);
    }
    Ok(found)
}

/// The messages at `tick`, and one period later.
fn at_both<'a>(of: &BTreeMap<u64, &'a Message>, tick: u64) -> Option<[&'a Message; 2]> {
    Some([*of.get(&tick)?, *of.get(&(tick + 1))?])
}

/// What the controller asks in the period of `tick`: until its answer arrives the stored trajectory
/// acts, which is that of the answer before.
fn asked(commands: &BTreeMap<u64, &Message>, tick: u64) -> Result<Vec<Velocity>, Trouble> {
    let mut asked = Vec::new();
    if let Some(command) = commands.get(&tick) {
        asked.push(triple(command, "input")?);
    }
    let before = tick.checked_sub(1).and_then(|before| commands.get(&before));
    let tail = before.map(|command| &command.fields["tail"][0]);
    if let Some(Ok(first)) = tail.map(|first| serde_json::from_value(first.clone())) {
        asked.push(first);
    }
    Ok(asked)
}

impl Period<'_> {
    /// Judges the period, and returns what is known of the obstacle after it.
    fn judge(
        &self,
        there: Option<There>,
        robot: &Robot,
        limits: &Limits,
        asked: &[Velocity],
        found: &mut Found,
    ) -> Result<There, Trouble> {
        let Self { tick, truths, states, obstacle } = self;
        let bare = robot.footprint().shape();
        let footprint = bare.grown(robot.footprint().clearance_m);
        let pose = &triple(truths[0], "pose")?;
        let placed = footprint.placed(pose);
        let measured = triple(truths[0], "velocity")?;
        let twists = truths.map(|truth| commanded(truth, limits).unwrap_or([f64::NAN; 3]));
        let apart = placed.separation(&obstacle.shape).distance_m;
        let mut there = there.unwrap_or_else(|| {
            let speed = measured[0].hypot(measured[1]).max(twists[0][0].hypot(twists[0][1]));
            found.moving += u64::from(speed > 0.1);
            // Response and two periods at full speed, then the ramp, of each axis at least.
            let way = speed * (robot.response_time_s() + 2.0 * limits.period_s)
                + 0.5 * speed * speed / limits.brake[0];
            There {
                since: *tick,
                is_far: apart > way,
                touch: None,
                has_touched: false,
                slowed_periods: 0,
            }
        });
        let touches = bare.placed(pose).separation(&obstacle.shape).distance_m;
        if there.is_far && touches <= 0.0 {
            found.violations.push(format!(
                "tick {tick}: the robot touches what appeared at tick {} far enough away: \
                 {touches:.3} m",
                there.since
            ));
        }
        if apart > 0.0 {
            there.touch = None;
        } else {
            let mut touch = there.touch.unwrap_or_else(|| {
                let ramp_s = (0..3).map(|axis| twists[0][axis].abs() / limits.brake[axis]);
                let ramp_s = ramp_s.fold(0.0, f64::max);
                let after = |seconds: f64| (seconds / limits.period_s).ceil() as u64 + RAMP_PERIODS;
                Touch {
                    ends: tick + after(ramp_s),
                    rests: tick + after(ramp_s + LAGS * robot.response_time_s()),
                    least_m: apart,
                }
            });
            found.touched += u64::from(!there.has_touched);
            there.has_touched = true;
            // The normal turns on the way, and the gate predicts the pose by its own output: the
            // least speed of all these poses counts.
            let poses =
                [*pose, triple(truths[1], "pose")?, predicted(pose, &twists[0], limits.period_s)];
            let closing = poses
                .iter()
                .map(|pose| closing_mps(&footprint.placed(pose), pose, &twists[1], obstacle))
                .fold(f64::INFINITY, f64::min);
            let brakes =
                (0..3).all(|axis| twists[1][axis].abs() <= twists[0][axis].abs() + ROUNDING);
            if *tick > touch.ends && !(closing <= SLACK_MPS || brakes) {
                found.violations.push(format!(
                    "tick {tick}: the obstacle of tick {} touches the footprint ({apart:.3} m), \
                     and the command closes in with {closing:.3} m/s",
                    there.since
                ));
            }
            if *tick <= touch.rests {
                touch.least_m = touch.least_m.min(apart);
            } else if apart < touch.least_m - DEEPER_M {
                found.violations.push(format!(
                    "tick {tick}: the robot is at {apart:.3} m from the obstacle of tick {}, and \
                     was at {:.3} m when it had braked",
                    there.since, touch.least_m
                ));
            }
            there.touch = Some(touch);
        }
        if is_slowed(states[1]) {
            found.slowed += 1;
            // A slowed robot gets less than what acted before or was sent: it never speeds up.
            let faster = (0..3).any(|axis| {
                let most = asked.iter().chain([&twists[0]]).map(|twist| twist[axis].abs());
                twists[1][axis].abs() > most.fold(0.0, f64::max) + ROUNDING
            });
            // A rejected answer leaves its place to the stored trajectory of the one before.
            let answered = truths[1].count("acting_tick") == *tick;
            if answered && faster {
                found.violations.push(format!(
                    "tick {tick}: the gate slows the robot from {:.3?} to {:.3?}, and {asked:.3?} \
                     was sent",
                    twists[0], twists[1]
                ));
            }
            // All that the robot does, or is to do, leads away.
            let leaves = [measured, twists[0], twists[1]].iter().chain(asked).all(|twist| {
                closing_mps(&placed, pose, twist, obstacle) < LEAVES_MPS
                    && is_straight(&placed, pose, twist, obstacle)
            });
            there.slowed_periods = if leaves { there.slowed_periods + 1 } else { 0 };
            if there.slowed_periods > RELEASE_PERIODS {
                found.violations.push(format!(
                    "tick {tick}: the robot is slowed, but it leaves the obstacle of tick {}",
                    there.since
                ));
            }
        } else {
            there.slowed_periods = 0;
        }
        Ok(there)
    }
}

/// Where a robot at `pose` is after `seconds` of a body velocity.
fn predicted(pose: &[f64; 3], [ahead, left, yaw]: &Velocity, seconds: f64) -> [f64; 3] {
    let (sin, cos) = pose[2].sin_cos();
    let velocity = [cos * ahead - sin * left, sin * ahead + cos * left, *yaw];
    std::array::from_fn(|axis| pose[axis] + velocity[axis] * seconds)
}

/// Largest speed of a corner of `footprint`, at `pose`, towards the obstacle \[m/s\].
fn closing_mps(
    footprint: &Shape,
    pose: &[f64; 3],
    [ahead, left, yaw]: &Velocity,
    obstacle: &Obstacle,
) -> f64 {
    let normal = footprint.separation(&obstacle.shape).normal;
    let (sin, cos) = pose[2].sin_cos();
    let [x, y] = [cos * ahead - sin * left, sin * ahead + cos * left];
    let corner = |[corner_x, corner_y]: &[f64; 2]| {
        let arm = [corner_x - pose[0], corner_y - pose[1]];
        (x - yaw * arm[1]) * normal[0] + (y + yaw * arm[0]) * normal[1]
    };
    footprint.corners().iter().map(corner).fold(f64::NEG_INFINITY, f64::max)
}

/// Whether a twist of a robot that leaves an obstacle does so at most 45° beside the normal, and
/// without a turn.
fn is_straight(
    footprint: &Shape,
    pose: &[f64; 3],
    [ahead, left, yaw]: &Velocity,
    obstacle: &Obstacle,
) -> bool {
    let [x, y] = footprint.separation(&obstacle.shape).normal;
    let (sin, cos) = pose[2].sin_cos();
    let velocity = [cos * ahead - sin * left, sin * ahead + cos * left];
    let along = velocity[0] * x + velocity[1] * y;
    let across = velocity[0] * y - velocity[1] * x;
    yaw.abs() <= LEAVES_RADPS && across.abs() <= -along
}

/// Three numbers of a message.
fn triple(message: &Message, field: &str) -> Result<[f64; 3], Trouble> {
    message.numbers(field).try_into().map_err(|_| format!("{field} has no three numbers").into())
}

/// The obstacles of a list.
fn listed(list: &Message) -> Result<Vec<Obstacle>, Trouble> {
    let rows = list.fields["obstacles"].as_array().ok_or("a list without obstacles")?;
    let obstacle = |row: &serde_json::Value| -> Result<Obstacle, Trouble> {
        let row: Vec<f64> =
            row.as_array().into_iter().flatten().filter_map(serde_json::Value::as_f64).collect();
        let (Some(&[x, y, radius]), Some(rest)) = (row.first_chunk(), row.get(3..)) else {
            return Err("an obstacle of fewer than three numbers".into());
        };
        let (corners, _) = rest.as_chunks::<2>();
        Ok(Obstacle { shape: Shape::hull(corners, radius)?, velocity_mps: [x, y] })
    };
    rows.iter().map(obstacle).collect()
}
