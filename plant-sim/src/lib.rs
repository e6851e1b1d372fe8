//! The truth: a simulated mecanum robot and its world, behind the same two topics as a real one.
//!
//! | module       | what it does                                                              |
//! |--------------|---------------------------------------------------------------------------|
//! | [`truth`]    | what is really the case: dynamics, friction, world, sensors. Pure         |
//! | [`settings`] | what a person may set                                                     |
//! | [`robot`]    | one period: gate, wheels, what is published                               |
//! | [`run`]      | the clock: real time or lock step                                         |
//!
//! Nothing here is known to the controller.

pub mod robot;
pub mod run;
pub mod settings;
pub mod truth;

pub use settings::Settings;
