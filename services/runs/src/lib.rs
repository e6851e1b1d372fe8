//! Run directories, and the graphs that run on this machine.
//!
//! | module       | contents                                                             |
//! |--------------|----------------------------------------------------------------------|
//! | [`folder`]   | the run directory                                                    |
//! | [`private`]  | directories that only this user can enter                            |
//! | [`registry`] | graphs on this machine, and the remains of launchers that have ended |
//! | [`epochs`]   | the highest epoch of each role, on disk                              |
//! | [`utc`]      | times as people read them                                            |

pub mod epochs;
pub mod folder;
pub mod private;
pub mod registry;
pub mod utc;
