//! Promise: on a network with certificates only authorised roles take part, and no other peer moves
//! the robot.

#[path = "attacks/driven.rs"]
mod driven;
#[path = "attacks/floods.rs"]
mod floods;
#[path = "attacks/gateway.rs"]
mod gateway;
#[path = "attacks/heartbeats.rs"]
mod heartbeats;
#[path = "attacks/matrix.rs"]
mod matrix;
#[path = "attacks/self_test.rs"]
mod self_test;
#[path = "attacks/session.rs"]
mod session;
#[path = "attacks/strangers.rs"]
mod strangers;
#[path = "attacks/told.rs"]
mod told;
