//! Telemetry is read-only: every connected client sees the robot, and no client can affect it or
//! send false data to others.

use bytemuck::Zeroable;
use network::telemetry::{Publisher, TelemetryError, TelemetryMessage, TelemetrySettings, Watcher};
use protocol::VERSION;
use protocol::message::{Message, Plan, PlantState};
use protocol::view::View;
use serde_json::{Value, json};
use std::error::Error;
use std::net::TcpListener;
use std::time::{Duration, Instant};
use zenoh::{Config, Session, Wait};

type Outcome = Result<(), Box<dyn Error>>;

const PERIOD: u64 = 20_000_000;
const SOON: Duration = Duration::from_millis(20);
const GIVES_UP_AFTER: Duration = Duration::from_mins(1);

fn publisher() -> Result<Publisher, TelemetryError> {
    Publisher::open(
        &TelemetrySettings {
            listen: vec!["tcp/127.0.0.1:0".into()],
            robot: "test".into(),
            credentials: None,
        },
        PERIOD,
    )
}

fn endpoint(publisher: &Publisher) -> Result<String, Box<dyn Error>> {
    Ok(publisher.endpoints().first().ok_or("no endpoint")?.clone())
}

fn state(tick: u64) -> PlantState {
    let mut state = PlantState::zeroed();
    (state.stamp.version, state.stamp.kind, state.stamp.tick) = (VERSION, PlantState::KIND, tick);
    state
}

/// A plain zenoh client, as a user would write it.
fn stranger(endpoint: &str) -> Result<Session, Box<dyn Error>> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).map_err(|error| error.to_string())?;
    }
    Ok(zenoh::open(config).wait().map_err(|error| error.to_string())?)
}

/// Publishes states of rising ticks until `done` returns a value.
fn publish_until<V>(
    publisher: &mut Publisher,
    mut done: impl FnMut() -> Option<V>,
) -> Result<V, Box<dyn Error>> {
    let begin = Instant::now();
    for tick in 1.. {
        publisher.publish(&state(tick))?;
        if let Some(value) = done() {
            return Ok(value);
        }
        if begin.elapsed() > GIVES_UP_AFTER {
            break;
        }
    }
    Err("nothing was received".into())
}

#[test]
fn any_client_can_read_a_message_as_json() -> Outcome {
    let mut publisher = publisher()?;
    let client = stranger(&endpoint(&publisher)?)?;
    let states = client
        .declare_subscriber("coxswain/*/state/json")
        .wait()
        .map_err(|error| error.to_string())?;
    let sample = publish_until(&mut publisher, || states.recv_timeout(SOON).ok().flatten())?;
    assert_eq!(sample.key_expr().as_str(), "coxswain/test/state/json");
    let value: Value = serde_json::from_slice(&sample.payload().to_bytes())?;
    let tick = value["stamp"]["tick"].as_u64().ok_or("no tick")?;
    assert_eq!(value, serde_json::to_value(View(&state(tick)))?);
    Ok(())
}

#[test]
fn a_watcher_receives_states_and_plans_as_they_were_published() -> Outcome {
    let mut publisher = publisher()?;
    let mut watcher = Watcher::open(&endpoint(&publisher)?, Some("test"))?;
    let mut plan = Plan::zeroed();
    (plan.stamp.version, plan.stamp.kind, plan.model_version) = (VERSION, Plan::KIND, 7);
    let first = publish_until(&mut publisher, || watcher.next(SOON).ok().flatten())?;
    assert_eq!((first.robot.as_str(), first.period_nanos), ("test", PERIOD));
    publisher.publish(&plan)?;
    let begin = Instant::now();
    while begin.elapsed() < GIVES_UP_AFTER {
        if let Some(telemetry) = watcher.next(SOON)?
            && let TelemetryMessage::Plan(received) = telemetry.message
        {
            assert_eq!((received.model_version, received.stamp.kind), (7, Plan::KIND));
            return Ok(());
        }
    }
    Err("no plan was received".into())
}

#[test]
fn a_value_put_by_a_stranger_reaches_no_watcher() -> Outcome {
    let mut publisher = publisher()?;
    let endpoint = endpoint(&publisher)?;
    let (forger, witness) = (stranger(&endpoint)?, stranger(&endpoint)?);
    let all = witness.declare_subscriber("**").wait().map_err(|error| error.to_string())?;
    let keys = [
        "coxswain/test/state",
        "coxswain/test/state/json",
        "coxswain/test/command",
        "coxswain/other/state",
        "forged",
    ];
    let mut genuine = 0;
    for round in 0..20 {
        for key in keys {
            forger.put(key, "forged").wait().map_err(|error| error.to_string())?;
        }
        let sample = publish_until(&mut publisher, || all.recv_timeout(SOON).ok().flatten())?;
        assert_ne!(
            sample.payload().to_bytes().as_ref(),
            b"forged",
            "on {} in round {round}",
            sample.key_expr()
        );
        genuine += 1;
    }
    assert_eq!(genuine, 20);
    Ok(())
}

#[test]
fn two_gateways_that_take_any_port_do_not_fight_and_a_taken_one_is_refused() -> Outcome {
    let (one, other) = (publisher()?, publisher()?);
    assert_ne!(one.endpoints(), other.endpoints());
    let taken = TelemetrySettings {
        listen: one.endpoints().to_vec(),
        robot: "test".into(),
        credentials: None,
    };
    assert!(matches!(Publisher::open(&taken, PERIOD), Err(TelemetryError::Listen { .. })));
    Ok(())
}

#[test]
fn a_watcher_without_a_gateway_gets_an_error() -> Outcome {
    // It listens, but never answers.
    let deaf = TcpListener::bind("127.0.0.1:0")?;
    let endpoint = format!("tcp/{}", deaf.local_addr()?);
    assert!(matches!(Watcher::open(&endpoint, None), Err(TelemetryError::Connect { .. })));
    drop(deaf);
    let refused = Watcher::open(&endpoint, None).map(drop);
    assert!(
        matches!(&refused, Err(TelemetryError::Connect { endpoint: at, .. }) if *at == endpoint),
        "{refused:?}"
    );
    Ok(())
}

#[test]
fn a_gateway_that_ends_is_noticed() -> Outcome {
    let publisher = publisher()?;
    let watcher = Watcher::open(&endpoint(&publisher)?, None)?;
    assert!(watcher.is_connected());
    publisher.close()?;
    let begin = Instant::now();
    while watcher.is_connected() && begin.elapsed() < GIVES_UP_AFTER {
        std::thread::yield_now();
    }
    assert!(!watcher.is_connected());
    Ok(())
}
