//! The threads of zenoh: one reads and writes all links, and one makes them, whoever begins.
//!
//! zenoh 1.10 lets one thread read a TLS connection while another writes it, which rustls does not allow
//! ([zenoh issue 2557](https://github.com/eclipse-zenoh/zenoh/issues/2557)): a writer that comes at a bad moment finds the connection's state taken away, and
//! the link ends, or the memory of the process is damaged. With one thread for both there is no such moment; and less is handed from thread to
//! thread, so that a round trip through a router is shorter as well.
//!
//! A link is to end when the certificate of its other end does. With one thread to make a link and another to watch for that, one that is made in the
//! last second of a certificate may be looked for before it is there, and then never ends. zenoh would make a client's first link with the thread
//! that opens the session, so clients are opened here.
//!
//! What is left: when a certificate ends, the thread that makes links flushes and closes a link that the other one may just be reading. And a callback of zenoh's must
//! not wait for zenoh (close a session, ask it who is there): tokio would go on reading and writing elsewhere meanwhile.
//!
//! zenoh learns of its threads from the environment alone, before the first session of a process.

use std::env;
use std::io;
use std::ops::Deref;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use zenoh::internal::runtime::{Runtime, RuntimeBuilder, ZRuntime};
use zenoh::{Config, Session, Wait};

/// The variable that zenoh reads.
pub const VARIABLE: &str = "ZENOH_RUNTIME";

/// What it has to say: who reads is the one who writes, and who accepts the one who connects.
pub const THREADS: &str = "(rx:(handover:tx),acc:(handover:net))";

/// Whether they are so in this process.
pub fn are_set() -> bool {
    env::var_os(VARIABLE).is_some_and(|value| value == THREADS)
}

/// Sets them, for this process and all that it starts: unless they are, the program starts anew in its own place, with the same arguments. To be
/// called first of all.
///
/// # Errors
/// What the system says if the program cannot be started anew.
pub fn set() -> io::Result<()> {
    if are_set() {
        return Ok(());
    }
    let mut arguments = env::args_os();
    let mut anew = Command::new(env::current_exe()?);
    anew.env(VARIABLE, THREADS);
    if let Some(name) = arguments.next() {
        anew.arg0(name);
    }
    // It returns only if it fails.
    Err(anew.args(arguments).exec())
}

/// A client's session, whose first link is made by the thread that makes all others. It ends when it is dropped.
pub(crate) struct Client {
    session: Session,
    runtime: Runtime,
    ended: AtomicBool,
}

impl Client {
    /// Connects, as `zenoh::open` does.
    pub(crate) fn open(config: Config) -> Result<Self, zenoh::Error> {
        let (tell, told) = channel();
        ZRuntime::Net.spawn(async move {
            // Who has asked waits for the answer.
            let _ = tell.send(connect(config).await);
        });
        let (client, connected) =
            told.recv().unwrap_or_else(|_| Err("zenoh's thread for links has ended".into()))?;
        connected.map(|()| client)
    }

    /// Ends it, also for those who still have it.
    pub(crate) fn close(&self) -> Result<(), zenoh::Error> {
        if self.ended.swap(true, Ordering::Relaxed) {
            return Ok(());
        }
        let session = self.session.close().wait();
        self.runtime.close().wait().and(session)
    }
}

/// A client, and whether it is connected. One that is not has to end as well, which zenoh's thread must not wait for.
async fn connect(config: Config) -> Result<(Client, Result<(), zenoh::Error>), zenoh::Error> {
    let mut runtime = RuntimeBuilder::new(config).build().await?;
    let session = zenoh::session::init(runtime.clone().into()).wait()?;
    let client = Client { session, runtime: runtime.clone(), ended: AtomicBool::new(false) };
    let connected = runtime.start().await;
    Ok((client, connected))
}

impl Deref for Client {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.session
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        if let Err(error) = self.close() {
            tracing::debug!(%error, "the session did not end in order");
        }
    }
}
