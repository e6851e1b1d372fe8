//! zenoh alone: as many bytes through the same kind of router, and nothing else.

use super::ends::client;
use super::{Failure, LONG};
use criterion::Criterion;
use std::sync::mpsc;
use zenoh::Wait;

/// Measures `bytes` there and back.
pub(crate) fn measure(
    criterion: &mut Criterion,
    endpoint: &str,
    name: &str,
    bytes: usize,
) -> Result<(), Failure> {
    let (here, there) = (client(endpoint)?, client(endpoint)?);
    let echo = there.clone();
    let back = move |sample: zenoh::sample::Sample| {
        let _ = echo.put("bare/back", sample.payload().clone()).wait();
    };
    let _echo = there.declare_subscriber("bare/there").callback(back).wait()?;
    let (heard, is_heard) = mpsc::channel();
    let note = move |sample: zenoh::sample::Sample| {
        let _ = heard.send(sample.payload().len());
    };
    let _ears = here.declare_subscriber("bare/back").callback(note).wait()?;
    let payload = vec![1_u8; bytes];
    // Messages are lost until both subscriptions are known everywhere.
    while is_heard.recv_timeout(std::time::Duration::from_millis(100)).is_err() {
        here.put("bare/there", payload.clone()).wait()?;
    }
    while is_heard.try_recv().is_ok() {}
    let mut failure = None;
    criterion.bench_function(&format!("round trip/zenoh alone, {name}"), |bencher| {
        bencher.iter(|| {
            let sent = here.put("bare/there", payload.clone()).wait();
            if let Err(error) = sent.and_then(|()| Ok(is_heard.recv_timeout(LONG)?)) {
                failure = Some(error);
            }
        });
    });
    failure.map_or(Ok(()), Err)
}
