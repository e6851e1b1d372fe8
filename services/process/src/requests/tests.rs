use super::*;
use crate::{HasRun, Pace, Run};
use settings::Check;
use settings::change::Rules;
use std::collections::BTreeSet;
use std::thread;
use std::time::Duration;
use transport::Links;

const RULES: Rules<'static> = Rules { tunable: &["gain"], choices: &[] };

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Plain {
    run: Run,
    gain: f64,
}

impl Check for Plain {}

impl HasRun for Plain {
    fn run(&self) -> &Run {
        &self.run
    }
}

fn run(folder: &Path, pace: Pace) -> Run {
    let links = Links::on_this_machine("test", folder.to_owned(), pace == Pace::LockStep, 0);
    Run { log: "off".into(), ..Run::new(folder, 1, links) }
}

fn request(change: &str) -> Request {
    Request { who: "ada".into(), asked_unix_nanos: 7, change: change.into() }
}

fn next(inbox: &mut Inbox) -> Option<Result<Request, NotAsked>> {
    thread::sleep(Duration::from_millis(12));
    inbox.take()
}

const APPLIED: Outcome =
    Outcome::Applied { plant_epoch: 1, taken_at_tick: 4, ready_at_tick: 4, acts_from_tick: 5 };

#[test]
fn every_request_is_read_once_and_in_order_and_its_reply_is_found()
-> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    let mut inbox = Inbox::open(&run(folder.path(), Pace::RealTime), Participant::Controller);
    assert!(next(&mut inbox).is_none());
    let asked: Vec<Asked> = ["gain = 1.0", "gain = 2.0"]
        .iter()
        .map(|change| ask(folder.path(), Participant::Controller, &request(change)))
        .collect::<Result<_, _>>()?;
    ask(folder.path(), Participant::Learner, &request("gain = 3.0"))?;
    assert_eq!(next(&mut inbox).ok_or("no request")??.change, "gain = 1.0");
    assert_eq!(asked[0].answer(), None);
    inbox.answer(APPLIED);
    assert_eq!(next(&mut inbox).ok_or("no request")??.change, "gain = 2.0");
    inbox.answer(Outcome::refused("value", &"no"));
    assert!(next(&mut inbox).is_none());
    assert_eq!(
        Answers::all(folder.path())
            .look()
            .into_iter()
            .map(|settled| settled.number)
            .collect::<Vec<_>>(),
        [1, 2]
    );
    assert_eq!(Answers::from_now_on(folder.path()).look(), []);
    let replies: Vec<_> = asked
        .iter()
        .filter_map(Asked::answer)
        .map(|settled| (settled.number, settled.request.change, settled.answer.outcome))
        .collect();
    assert_eq!(
        replies,
        [
            (1, "gain = 1.0".to_owned(), APPLIED),
            (2, "gain = 2.0".to_owned(), Outcome::refused("value", &"no"))
        ]
    );
    Ok(())
}

#[test]
fn a_restarted_process_applies_the_earlier_changes_and_reads_the_open_requests()
-> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    let run = run(folder.path(), Pace::RealTime);
    let mut inbox = Inbox::open(&run, Participant::Controller);
    for (gain, outcome) in [(1.0, APPLIED), (2.0, APPLIED), (3.0, Outcome::refused("value", &"no"))]
    {
        ask(folder.path(), Participant::Controller, &request(&format!("gain = {gain:?}")))?;
        drop(next(&mut inbox).ok_or("no request")??);
        inbox.answer(outcome);
    }
    ask(folder.path(), Participant::Controller, &request("gain = 4.0"))?;
    let (settings, count) =
        changed_before(&Plain { run: run.clone(), gain: 0.0 }, Participant::Controller, &RULES)?;
    assert_eq!((settings.gain, count), (2.0, 2));
    let mut again = Inbox::open(&run, Participant::Controller);
    assert_eq!(next(&mut again).ok_or("no request")??.change, "gain = 4.0");
    Ok(())
}

#[test]
fn simultaneous_requests_get_consecutive_numbers() -> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    let ask_often = || {
        (0..25)
            .filter_map(|_| ask(folder.path(), Participant::Learner, &request("gain = 1.0")).ok())
            .map(|asked| asked.number)
            .collect::<Vec<_>>()
    };
    let numbers: Vec<u64> = thread::scope(|scope| {
        let asking: Vec<_> = (0..4).map(|_| scope.spawn(ask_often)).collect();
        asking.into_iter().flat_map(|thread| thread.join().unwrap_or_default()).collect()
    });
    assert_eq!(numbers.len(), 100);
    assert_eq!(numbers.into_iter().collect::<BTreeSet<_>>(), (1..=100).collect());
    Ok(())
}

#[test]
fn requests_in_lock_step_and_invalid_files_are_rejected_with_a_reason()
-> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    ask(folder.path(), Participant::Controller, &request("gain = 1.0"))?;
    fs::write(request_file(folder.path(), Participant::Learner, 1), "{\"who\": 3}")?;
    let refusal = |role, pace| -> Option<NotAsked> {
        let mut inbox = Inbox::open(&run(folder.path(), pace), role);
        next(&mut inbox)?.err()
    };
    let reason = refusal(Participant::Controller, Pace::LockStep);
    assert!(matches!(reason, Some(NotAsked::LockStep)), "{reason:?}");
    let reason = refusal(Participant::Learner, Pace::RealTime);
    assert!(matches!(reason, Some(NotAsked::NotARequest(_))), "{reason:?}");
    Ok(())
}

#[test]
fn a_run_without_a_request_directory_accepts_no_request() -> Result<(), Box<dyn std::error::Error>>
{
    let folder = tempfile::tempdir()?;
    let refused = ask(folder.path(), Participant::Controller, &request("gain = 1.0"))
        .map_err(|error| error.to_string());
    assert!(refused.as_ref().is_err_and(|refused| refused.contains("set")), "{refused:?}");
    Ok(())
}

#[test]
fn of_two_requests_the_one_made_before_is_known_unless_the_clock_was_set_back() {
    let now = Request::new("ada", "x").asked_unix_nanos;
    let made = |asked_unix_nanos| Request { asked_unix_nanos, ..request("x") };
    assert_eq!(made(now - 9).made_before(now), Some(Duration::from_nanos(9)));
    assert_eq!(made(now).made_before(now), None);
    assert_eq!(made(now + 9).made_before(now), None);
    assert_eq!(made(now - 9).made_before(0), None);
    // The present one was made by a clock that ran fast, before it was set back.
    assert_eq!(made(now).made_before(now + 60_000_000_000), None);
}
