//! Ports that cannot be opened, and the reasons.

use crate::fixture::{Fixture, Outcome, Shared};
use protocol::message::{Command, Health};
use protocol::topic::{Delivery, Topic};
use std::path::PathBuf;
use transport::{GRAPH_NAME_MAX, Identity, OpenError, Ports, Since};

#[test]
fn processes_that_disagree_about_lock_step_refuse_each_other() -> Outcome {
    let graph = Shared::new(true)?;
    let _source = graph.ports(1)?.source::<Command>(Since::First)?;
    let mut links = graph.links.clone();
    links.lock_step = false;
    let ports = Ports::open(&links, Identity::new(1))?;
    let refused = ports.sink::<Command>().map(drop);
    assert!(
        matches!(
            &refused,
            Err(OpenError::Delivery { topic: Topic::Command, delivery: Delivery::NewestWins })
        ),
        "{refused:?}"
    );
    let _health = ports.sink::<Health>()?;
    Ok(())
}

#[test]
fn a_graph_name_that_would_not_keep_graphs_apart_is_refused() -> Outcome {
    let graph = Shared::new(false)?;
    for name in ["", "a.b", "a/b", "A", "ä", &"a".repeat(GRAPH_NAME_MAX + 1)] {
        let mut links = graph.links.clone();
        name.clone_into(&mut links.graph);
        let refused = Ports::open(&links, Identity::new(1)).map(drop);
        assert!(
            matches!(&refused, Err(OpenError::GraphName { graph }) if graph == name),
            "{refused:?}"
        );
    }
    Ok(())
}

#[test]
fn a_root_that_is_too_long_for_sockets_is_refused_before_anything_is_made() -> Outcome {
    let graph = Shared::new(false)?;
    let mut links = graph.links.clone();
    links.root = PathBuf::from(format!("/tmp/{}", "x".repeat(100)));
    let refused = Ports::open(&links, Identity::new(1)).map(drop);
    assert!(matches!(&refused, Err(OpenError::RootTooLong { length: 105, .. })), "{refused:?}");
    assert!(!links.root.exists());
    Ok(())
}

#[test]
fn the_longest_root_and_name_that_are_allowed_do_work() -> Outcome {
    let graph = Shared::new(false)?;
    let mut links = graph.links.clone();
    links.graph = format!("{:x<GRAPH_NAME_MAX$}", links.graph);
    let room = 107 - 46 - (4 + GRAPH_NAME_MAX) - links.root.as_os_str().len();
    links.root = PathBuf::from(format!("{}{}", links.root.display(), "r".repeat(room)));
    {
        let ports = Ports::open(&links, Identity::new(1))?;
        let mut source = ports.source::<Health>(Since::First)?;
        assert!(!source.wait(crate::fixture::BRIEF)?, "its socket has a path");
    }
    transport::sweep(&links)?;
    assert!(!links.root.exists());
    Ok(())
}
