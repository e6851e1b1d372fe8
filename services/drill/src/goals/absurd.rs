//! Goals that no robot can do, and goals at the border of what one can do.

use super::Given;
use super::planner::{Planner, all_settled, requested, tell, wait_until};
use crate::measure::Measured;
use crate::session::{Home, Session, Trouble};
use process::Stop;
use process::requests::{Outcome, Request, Settled, ask};
use protocol::message::Participant;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::fmt::Write;
use std::fs;

/// Way of the main goal for each absurd one, so that the robot still drives \[m\].
const WAY_M: f64 = 0.3;
/// Exit code of a command whose goal is rejected.
const REJECTED: i32 = 2;
/// Bytes that are too many for a request.
const TOO_MANY_BYTES: usize = 3 << 20;
/// Points that are too many for a path.
const TOO_MANY_POINTS: usize = 10_001;

/// How a goal is given.
enum How {
    /// By `coxswain follow`, with this file and these options.
    Path(String, Vec<&'static str>),
    /// By `coxswain` with these arguments.
    Command(Vec<String>),
    /// As the text of a request.
    Text(String),
    /// As the bytes of a file in the place of a request.
    Bytes(Vec<u8>),
}

/// Gives absurd goals while the robot drives to its goal, then while it stands. In the end it gives
/// goals that are possible, but only just.
pub(super) fn give(
    home: &Home<'_>,
    session: &Session,
    times: u32,
    seed: u64,
    stop: &Stop,
    measured: &mut Measured,
) -> Result<Given, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut given = Given::default();
    let far = (2.0 + WAY_M * f64::from(times)).to_string();
    let mut main = Planner::start(home, session, "main", &["go", &far, "0", "0", "--speed", "1"])?;
    wait_until("the main goal", stop, || Ok(!all_settled(session.run()).is_empty()))?;
    for round in 0..times {
        if stop.requested() {
            break;
        }
        let kind = (round + (seed % 1000) as u32) % KINDS;
        let before = requested(session.run());
        let rejected = reject(home, session, absurd(kind, &mut random), stop)?;
        given.absurd.extend(before + 1..=requested(session.run()));
        measured.injections += 1;
        if !rejected {
            measured.violations.push(format!("round {round}, kind {kind}: it was not rejected"));
        }
    }
    if main.exit_code(stop)? != Some(0) {
        measured.violations.push("the main goal was not reached".to_owned());
    }
    // A path without length: the robot stands at all of its points.
    let before = requested(session.run());
    let points = format!("x_m,y_m\n{far},0\n{far},0\n{far},0\n");
    if !reject(home, session, How::Path(points, vec![]), stop)? {
        measured.violations.push("a path without length was not rejected".to_owned());
    }
    given.absurd.extend(before + 1..=requested(session.run()));
    measured.injections += 1;
    possible(home, session, (&far, times), &mut random, stop, measured)?;
    Ok(given)
}

/// Gives the goal, and returns whether it was rejected.
fn reject(home: &Home<'_>, session: &Session, how: How, stop: &Stop) -> Result<bool, Trouble> {
    match how {
        How::Path(text, options) => {
            let file = home.folder().join("absurd.csv");
            fs::write(&file, text)?;
            let name = file.to_string_lossy();
            let arguments = [&["follow", &*name], options.as_slice()].concat();
            Ok(tell(home, session, &arguments, stop)? == Some(REJECTED))
        }
        How::Command(arguments) => {
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            Ok(tell(home, session, &arguments, stop)? == Some(REJECTED))
        }
        How::Text(text) => {
            let request = Request::new("planner", text);
            let asked = ask(session.run(), Participant::Controller, &request)?;
            is_refused(session, asked.number, stop)
        }
        How::Bytes(bytes) => {
            let number = requested(session.run()) + 1;
            let folder = session.run().join("set");
            // Written at once, as a request is.
            fs::write(folder.join("absurd"), bytes)?;
            fs::rename(folder.join("absurd"), folder.join(format!("controller-{number:06}.json")))?;
            is_refused(session, number, stop)
        }
    }
}

fn is_refused(session: &Session, number: u64, stop: &Stop) -> Result<bool, Trouble> {
    let mut outcome = None;
    wait_until("a reply", stop, || {
        let settled = Settled::read(session.run(), Participant::Controller, number);
        outcome = settled.map(|settled| settled.answer.outcome);
        Ok(outcome.is_some())
    })?;
    Ok(matches!(outcome, Some(Outcome::Refused { code, .. }) if !code.is_empty()))
}

/// Number of kinds of [`absurd`] goals.
const KINDS: u32 = 22;

fn absurd(kind: u32, random: &mut Pcg64Mcg) -> How {
    let wrong = ["nan", "inf", "-inf"][random.random_range(0..3)];
    let side = if random.random() { 1.0 } else { -1.0 };
    let far = side * 10_f64.powf(random.random_range(6.0..300.0));
    let place = random.random_range(0..3);
    let pose = |value: &str| {
        let mut numbers = ["0.5"; 3];
        numbers[place] = value;
        How::Text(format!("# goal\n[goal.pose]\nto = [{}]\n", numbers.join(", ")))
    };
    let velocity = |velocity: &str, valid: &str| {
        How::Text(format!("# goal\n[goal.velocity]\nvelocity = {velocity}\nvalid_s = {valid}\n"))
    };
    let limit = |value: &str| {
        How::Text(format!("# goal\n[goal.pose]\nto = [0.0, 0.0, 0.0]\n[limits]\n{value}\n"))
    };
    let path = |points: &str| How::Path(format!("x_m,y_m\n{points}"), vec![]);
    let heading =
        |text: &str| How::Path("x_m,y_m,yaw_rad\n1,0,0\n1,1,NAN\n".replace("NAN", text), vec![]);
    match kind {
        0 => pose(wrong),
        // Beyond the limits of a place: x and y a million metres away.
        1 => How::Command(["go", &format!("{:e}", far.abs()), "0", "0"].map(str::to_owned).into()),
        2 => How::Command(["go", "1000000", "0", "0"].map(str::to_owned).into()),
        3 => path(&format!("0.1,0\n{wrong},1\n")),
        4 => path(&format!("0.1,{far:e}\n")),
        5 => path("1000000,1000000\n1000001,1000000\n"),
        6 => path(&"0.1,0.1\n".repeat(TOO_MANY_POINTS)),
        7 => path(""),
        8 => How::Text("# goal\n[goal.path]\npoints = []\n".to_owned()),
        9 => heading(wrong),
        10 => How::Command(
            ["go", "1", "0", "0", "--speed", &format!("{:e}", far.abs())].map(str::to_owned).into(),
        ),
        11 => How::Command(["go", "1", "0", "0", "--speed", "0"].map(str::to_owned).into()),
        12 => limit(&format!("acceleration_mps2 = {wrong}")),
        13 => limit("yaw_rate_radps = -1.0"),
        14 => velocity(&format!("[{wrong}, 0.0, 0.0]"), "1.0"),
        15 => velocity(&format!("[0.0, 0.0, {far:.1}]"), "1.0"),
        16 => velocity("[0.3, 0.0, 0.0]", ["nan", "inf", "0.0", "-1.0", "61.0"][place + 2]),
        17 => velocity("[0.3, 0.0, 0.0]", ["nan", "inf", "0.0"][place]),
        18 => How::Text("# goal\n[goal.jump]\nto = [0.0, 0.0, 1.0]\n".to_owned()),
        19 => How::Text(format!("# goal\ngoal = {}", "[".repeat(100_000))),
        20 => How::Bytes(vec![b' '; TOO_MANY_BYTES]),
        _ => How::Bytes((0..random.random_range(0..300)).map(|_| random.random()).collect()),
    }
}

/// Points of a path: position \[m\].
fn csv(points: impl IntoIterator<Item = [f64; 2]>) -> String {
    let mut text = "x_m,y_m\n".to_owned();
    for [x, y] in points {
        let _ = writeln!(text, "{x},{y}");
    }
    text
}

/// Goals that are harder than any robot should get, but possible: sharp turns, repeated points, and
/// velocities far above the limits, which are scaled down. Each is done within the limits.
fn possible(
    home: &Home<'_>,
    session: &Session,
    (at, times): (&str, u32),
    random: &mut Pcg64Mcg,
    stop: &Stop,
    measured: &mut Measured,
) -> Result<(), Trouble> {
    let begin: f64 = at.parse()?;
    for round in 0..times.div_ceil(20) {
        let hairpin = (0..6).map(|index| [begin + f64::from(index % 2), 0.0]);
        let repeated = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.4]];
        let repeated = repeated.iter().flat_map(|[x, y]| [[begin + x, *y]; 40]);
        let mut near = || random.random_range(-0.4..0.4);
        let crooked: Vec<[f64; 2]> = (0..10).map(|_| [begin + near(), near()]).collect();
        for points in [csv(hairpin), csv(repeated), csv(crooked)] {
            let file = home.folder().join("crooked.csv");
            fs::write(&file, points)?;
            let name = file.to_string_lossy();
            let code = tell(home, session, &["follow", &name, "--heading", "tangent"], stop)?;
            if code != Some(0) {
                measured.violations.push(format!("round {round}: a path ended with {code:?}"));
            }
            measured.injections += 1;
            let code = tell(home, session, &["go", at, "0", "0"], stop)?;
            if code != Some(0) {
                measured.violations.push(format!("round {round}: back with {code:?}"));
            }
        }
        let code = tell(home, session, &["drive", "900", "-900", "500", "--for", "0.3"], stop)?;
        if code != Some(0) {
            measured.violations.push(format!("round {round}: a velocity ended with {code:?}"));
        }
        measured.injections += 1;
        tell(home, session, &["go", at, "0", "0"], stop)?;
    }
    Ok(())
}
