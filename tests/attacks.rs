//! Promise: on a network with certificates only the hosts of the graph take part, and no other peer
//! moves the robot.

#[path = "attacks/gateway.rs"]
mod gateway;
#[path = "attacks/hosts.rs"]
mod hosts;
#[path = "attacks/requests.rs"]
mod requests;
#[path = "attacks/session.rs"]
mod session;
