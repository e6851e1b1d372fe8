//! The carrier between machines, over zenoh.

use super::carrier::{Inlet, Outlet};
use super::{Links, OpenError};
use crate::topic::Topic;
use std::convert::Infallible;

/// This thread's membership in one graph.
pub(super) struct Network(Infallible);

impl Network {
    pub(super) fn open(links: &Links) -> Result<Self, OpenError> {
        Err(OpenError::Join { graph: links.graph.clone(), reason: "the network carrier is not built yet".to_owned() })
    }

    pub(super) fn outlet(&self, _topic: Topic) -> Result<Box<dyn Outlet>, OpenError> {
        match self.0 {}
    }

    pub(super) fn inlet(&self, _topic: Topic) -> Result<Box<dyn Inlet>, OpenError> {
        match self.0 {}
    }
}

/// Stub, until the carrier is merged.
#[derive(Debug)]
pub struct Router;
impl Router {
    /// Stub.
    pub fn open(_listen: &[String], _connect: &[String]) -> Result<Self, OpenError> {
        Ok(Self)
    }
    /// Stub.
    pub fn endpoints(&self) -> Vec<String> {
        Vec::new()
    }
}
