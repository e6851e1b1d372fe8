//! The command line. Its larger commands have crates of their own.
//!
//! | command                                     | place                                    |
//! |---------------------------------------------|------------------------------------------|
//! | `launch`                                    | crate `supervisor`                       |
//! | `watch`                                     | crate `viewer`                           |
//! | `certificates`                              | crate `certificates`                     |
//! | `drill`, `offer`                            | crate `drill`                            |
//! | `experiment`                                | crate `experiment`                       |
//! | `set`: settings while the robot drives      | [`set`]                                  |
//! | `arm`, `resume`, `stop`: orders to the plant | [`order`]                               |
//! | `go`, `hold`, `follow`: goals               | [`goal`]                                 |
//! | `drive`: a velocity, or the keyboard        | [`drive`]                                |
//! | `status`: what the robot does now           | [`status`]                               |
//! | lists of obstacles, for programs            | [`obstacles`]                            |
//! | `router`: a zenoh router where hosts meet   | [`router`]                               |
//! | `report`, `export`: reports and tables      | [`records`]                              |

pub mod drive;
pub mod goal;
pub mod joined;
pub mod obstacles;
pub mod order;
pub mod records;
pub mod router;
pub mod set;
pub mod status;
