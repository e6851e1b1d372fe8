//! Promise: on a network with certificates only the hosts of the graph take part, and no other peer
//! moves the robot.

mod gateway;
mod hosts;
mod requests;
mod session;
mod two_hosts;
