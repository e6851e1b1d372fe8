//! Clients of a router that goes and returns, and routers that are joined, reconnect at any moment.

#[path = "said/commands.rs"]
mod commands;

use bytemuck::Zeroable;
use commands::{command, until};
use protocol::message::{Command, Credit};
use protocol::topic::Topic;
use std::error::Error;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::slice;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use transport::{Carrier, Carriers, Identity, Links, Ports, Router, Since, Sink, Source};

type Outcome = Result<(), Box<dyn Error>>;

/// Far longer than reconnecting takes on any test machine.
const GIVES_UP_AFTER: Duration = Duration::from_mins(1);
const SOON: Duration = Duration::from_millis(20);
/// How long a lossless writer waits for room.
const PATIENCE: Duration = Duration::from_millis(300);

/// Number of routers in sequence.
const REPLACEMENTS: u32 = 10;
/// Longest time without a router \[ms\]: the times are longer and shorter than zenoh takes to
/// compute new routes.
const GAP_MILLIS_MAX: u64 = 300;

fn any_port() -> [String; 1] {
    ["tcp/127.0.0.1:0".to_owned()]
}

fn first(router: &Router) -> Result<&String, Box<dyn Error>> {
    Ok(router.endpoints().first().ok_or("it listens nowhere")?)
}

fn ports(endpoint: &str, lock_step: bool) -> Result<Ports, Box<dyn Error>> {
    let (carriers, connect) = (Carriers::all(Carrier::Network), vec![endpoint.to_owned()]);
    Ok(Ports::open(
        &Links {
            carriers,
            connect,
            ..Links::on_this_machine("t", "", lock_step, PATIENCE.as_millis() as u64)
        },
        Identity::new(1),
    )?)
}

/// Two clients, one of which sends to the other.
struct Pair {
    sink: Sink<Credit>,
    source: Source<Credit>,
    said: u64,
}

impl Pair {
    fn new(writer: &str, reader: &str) -> Result<Self, Box<dyn Error>> {
        let source = ports(reader, false)?.source(Since::Joining)?;
        let mut pair = Self { sink: ports(writer, false)?.sink()?, source, said: 0 };
        pair.talks()?;
        Ok(pair)
    }

    /// Sends until a message sent from now on is received.
    fn talks(&mut self) -> Outcome {
        let (begin, before) = (Instant::now(), self.said);
        while begin.elapsed() < GIVES_UP_AFTER {
            self.said += 1;
            self.sink.send(&mut Credit { through_tick: self.said, ..Credit::zeroed() })?;
            self.source.wait(SOON)?;
            if self.source.latest()?.is_some_and(|credit| credit.through_tick > before) {
                return Ok(());
            }
        }
        Err("nothing that is said is heard any more".into())
    }
}

/// Seeded, evenly spread times.
struct Times(u64);

impl Times {
    fn below(&mut self, millis: u64) -> Duration {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        Duration::from_millis((self.0 >> 33) % millis)
    }
}

/// Replaces `router` many times. Once in `found` replacements, the clients get the time to find the
/// new router.
fn replace(mut router: Router, pair: &mut Pair, found: u32) -> Outcome {
    let (endpoints, mut times) = (router.endpoints().to_vec(), Times(7));
    for round in 0..REPLACEMENTS {
        drop(router);
        thread::sleep(times.below(GAP_MILLIS_MAX));
        router = Router::open(&endpoints, &[])?;
        if round % found == 0 {
            pair.talks().map_err(|error| format!("router {round}: {error}"))?;
        } else {
            thread::sleep(times.below(GAP_MILLIS_MAX));
        }
    }
    pair.talks()
}

#[test]
fn clients_communicate_again_after_each_of_many_replacements_of_their_router() -> Outcome {
    let router = Router::open(&any_port(), &[])?;
    let mut pair = Pair::new(first(&router)?, first(&router)?)?;
    replace(router, &mut pair, 2)
}

#[test]
fn clients_of_joined_routers_communicate_again_after_each_of_many_replacements_of_one() -> Outcome {
    let near = Router::open(&any_port(), &[])?;
    let far = Router::open(&any_port(), near.endpoints())?;
    let mut pair = Pair::new(first(&near)?, first(&far)?)?;
    replace(near, &mut pair, 1)
}

#[test]
fn a_client_whose_router_hangs_up_on_it_as_it_connects_talks_again() -> Outcome {
    let router = Router::open(&any_port(), &[])?;
    let relay = Relay::before(first(&router)?)?;
    let mut pair = Pair::new(first(&router)?, &relay.endpoint)?;
    relay.interrupt(&mut pair, [0, 1, 5, 20])
}

#[test]
fn clients_of_joined_routers_communicate_again_after_cuts_however_short() -> Outcome {
    let near = Router::open(&any_port(), &[])?;
    let relay = Relay::before(first(&near)?)?;
    let far = Router::open(&any_port(), slice::from_ref(&relay.endpoint))?;
    let mut pair = Pair::new(first(&near)?, first(&far)?)?;
    relay.interrupt(&mut pair, [0; 4])
}

#[test]
fn a_reader_that_was_cut_off_gets_the_last_snapshot_once_the_link_is_back() -> Outcome {
    let router = Router::open(&any_port(), &[])?;
    let endpoints = router.endpoints().to_vec();
    let mut credits = ports(first(&router)?, false)?.source::<Credit>(Since::Joining)?;
    let mut granted = ports(first(&router)?, false)?.sink::<Credit>()?;
    granted.send(&mut Credit { through_tick: 1, ..Credit::zeroed() })?;
    until(&mut credits, |credit| credit.through_tick == 1)?;
    drop(router);
    granted.send(&mut Credit { through_tick: 2, ..Credit::zeroed() })?;
    assert!(!credits.wait(PATIENCE)?, "it is cut off");
    let _router = Router::open(&endpoints, &[])?;
    until(&mut credits, |credit| credit.through_tick == 2)?;
    Ok(())
}

#[test]
fn messages_sent_during_a_cut_are_not_lost_in_lock_step() -> Outcome {
    let mut router = Router::open(&any_port(), &[])?;
    let endpoints = router.endpoints().to_vec();
    let mut commands = ports(first(&router)?, true)?.source::<Command>(Since::First)?;
    let mut sink = ports(first(&router)?, true)?.sink::<Command>()?;
    for round in 0..3 {
        drop(router);
        for tick in 1..=10 {
            sink.send(&mut command(10 * round + tick))?;
        }
        router = Router::open(&endpoints, &[])?;
        for tick in 1..=10 {
            until(&mut commands, |command| command.stamp.tick == 10 * round + tick)?;
        }
    }
    assert_eq!((commands.tally().received, commands.tally().lost), (30, 0));
    Ok(())
}

#[test]
fn messages_sent_while_the_link_reconnects_are_not_lost_in_lock_step() -> Outcome {
    let mut router = Router::open(&any_port(), &[])?;
    let endpoints = router.endpoints().to_vec();
    let mut commands = ports(first(&router)?, true)?.source::<Command>(Since::First)?;
    let mut sink = ports(first(&router)?, true)?.sink::<Command>()?;
    let mut sent = 1;
    sink.send(&mut command(sent))?;
    until(&mut commands, |command| command.stamp.tick == sent)?;
    for _ in 0..5 {
        drop(router);
        router = Router::open(&endpoints, &[])?;
        // Sends until a message sent after the cut is received, and beyond; but no more than the
        // link remembers.
        let before = sent;
        let mut received = before;
        for _ in 0..Topic::Command.quality(true).depth - 6 {
            sent += 1;
            sink.send(&mut command(sent))?;
            commands.wait(Duration::from_millis(if received > before { 0 } else { 5 }))?;
            while let Some(command) = commands.next()? {
                received = command.stamp.tick;
            }
        }
        if received < sent {
            until(&mut commands, |command| command.stamp.tick == sent)?;
        }
    }
    assert_eq!((commands.tally().received, commands.tally().lost), (sent, 0));
    Ok(())
}

/// A relay before a router. It can close connections.
struct Relay {
    endpoint: String,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    /// Connections that are still to be closed as soon as the router has accepted them.
    hang_ups: AtomicU32,
    /// Connections made before it was incremented are cut.
    cuts: AtomicU32,
    closed: AtomicBool,
}

/// Messages that a router sends until it has accepted a connection.
const HANDSHAKE: u32 = 2;

impl Relay {
    fn before(router: &str) -> Result<Self, Box<dyn Error>> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let endpoint = format!("tcp/{}", listener.local_addr()?);
        let router = router.strip_prefix("tcp/").ok_or("no tcp")?.to_owned();
        let shared = Arc::new(Shared::default());
        let relay = Self { endpoint, shared: Arc::clone(&shared) };
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                if shared.closed.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(far) = TcpStream::connect(&router) else { continue };
                let hangs_up = shared
                    .hang_ups
                    .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1))
                    .is_ok();
                let forwarded = if hangs_up { HANDSHAKE } else { u32::MAX };
                let cuts = shared.cuts.load(Ordering::Relaxed);
                for (from, to, most) in
                    [(near.try_clone(), far.try_clone(), u32::MAX), (Ok(far), Ok(near), forwarded)]
                {
                    if let (Ok(from), Ok(to)) = (from, to) {
                        let shared = Arc::clone(&shared);
                        thread::spawn(move || {
                            carry(from, to, most, || shared.cuts.load(Ordering::Relaxed) > cuts);
                        });
                    }
                }
            }
        });
        Ok(relay)
    }

    /// Cuts the connection again and again. Each time it closes a number of the following
    /// connections at once.
    fn interrupt(&self, pair: &mut Pair, hang_ups: [u32; 4]) -> Outcome {
        for hang_ups in hang_ups {
            self.shared.hang_ups.store(hang_ups, Ordering::Relaxed);
            self.shared.cuts.fetch_add(1, Ordering::Relaxed);
            // Until the cut is noticed.
            thread::sleep(SOON);
            pair.talks().map_err(|error| format!("{hang_ups} hang-ups: {error}"))?;
        }
        Ok(())
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        self.shared.cuts.fetch_add(1, Ordering::Relaxed);
        // Wakes its thread.
        let _ = self.endpoint.strip_prefix("tcp/").map(TcpStream::connect);
    }
}

/// Forwards at most `most` pieces until it is cut.
fn carry(mut from: TcpStream, mut to: TcpStream, most: u32, is_cut: impl Fn() -> bool) {
    let mut bytes = vec![0; 64 * 1024];
    let _ = from.set_read_timeout(Some(SOON / 10));
    let _ = to.set_nodelay(true);
    let mut carried = 0;
    while carried < most && !is_cut() {
        match from.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) if bytes.get(..count).is_some_and(|bytes| to.write_all(bytes).is_ok()) => {
                carried += 1;
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Ok(_) | Err(_) => break,
        }
    }
    let _ = to.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}
