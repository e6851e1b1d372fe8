//! The threads of zenoh: one reads and writes all links, and one makes them at either end.
//!
//! zenoh 1.10 lets one thread read a TLS connection while another writes it, which rustls does not
//! allow ([zenoh issue 2557](https://github.com/eclipse-zenoh/zenoh/issues/2557)). A writer that
//! arrives at a bad moment finds the connection's state taken away. Then the link ends, or the
//! memory of the process is damaged. With one thread for both there is no such moment. It also
//! hands less from thread to thread, so that a round trip through a router is shorter.
//!
//! A link must end when the certificate of its other end expires. If one thread makes a link and
//! another watches for the expiry, a link made in the last second of a certificate may be missed.
//! The watch looks for it before it exists, and the link never ends. zenoh would make a client's
//! first link with the thread that opens the session, so clients are opened here.
//!
//! Two limits remain. When a certificate expires, the thread that makes links flushes and closes a
//! link that the other thread may just be reading. And a callback of zenoh must not wait for zenoh
//! (close a session, query its peers): tokio would continue to read and write on other threads
//! meanwhile.
//!
//! zenoh reads the setting of its threads from the environment alone, before the first session of a
//! process.

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

/// Its value: one thread reads and writes, and one thread accepts and connects.
pub const THREADS: &str = "(rx:(handover:tx),acc:(handover:net))";

/// Whether the variable is set so in this process.
pub fn are_set() -> bool {
    env::var_os(VARIABLE).is_some_and(|value| value == THREADS)
}

/// Sets it for this process and all its children. Unless it is set already, the program restarts in
/// place, with the same arguments. Call it first of all.
///
/// # Errors
/// The system's error if the program cannot restart.
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

/// A client's session. Its first link is made by the thread that makes all others. The session ends
/// when this value is dropped.
pub struct Client {
    session: Session,
    runtime: Runtime,
    ended: AtomicBool,
}

impl Client {
    /// Connects, as `zenoh::open` does.
    pub fn open(config: Config) -> Result<Self, zenoh::Error> {
        let (tell, told) = channel();
        ZRuntime::Net.spawn(async move {
            // The calling thread waits for the answer.
            let _ = tell.send(connect(config).await);
        });
        let (client, connected) =
            told.recv().unwrap_or_else(|_| Err("zenoh's thread for links has ended".into()))?;
        connected.map(|()| client)
    }

    /// Ends the session, also for other holders of it.
    pub fn close(&self) -> Result<(), zenoh::Error> {
        if self.ended.swap(true, Ordering::Relaxed) {
            return Ok(());
        }
        let session = self.session.close().wait();
        self.runtime.close().wait().and(session)
    }
}

/// A client, and whether it is connected. A client without a connection must be ended as well, and
/// zenoh's thread must not wait for that.
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
