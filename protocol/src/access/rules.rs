//! Roles → zenoh's access control: who is not named may nothing, and whoever is named no more than its topics need.
//!
//! zenoh judges each message twice, where it arrives and where it leaves. A message is allowed if a rule of its sender's (or receiver's) role
//! has a key expression that includes its own.

use super::Role;
use crate::topic::Topic;
use serde_json::{Value, json};

/// Keys of the tokens by which routers are known.
const ROUTERS: &str = "coxswain-router/*";

/// Most bytes of one put. A longer message goes in pieces.
pub(crate) const PUT_BYTES_MAX: usize = 64 * 1024;

/// Every kind of message that zenoh's access control knows.
const ALL_MESSAGES: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Which way a message goes, as its router sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Flow {
    Ingress,
    Egress,
}

/// What one role may do.
#[derive(Debug, Default)]
struct Allowed(Vec<(Flow, &'static str, String)>);

impl Allowed {
    fn add(&mut self, flow: Flow, message: &'static str, key: impl Into<String>) {
        self.0.push((flow, message, key.into()));
    }

    /// What a writer of the topic with this `base` does and is told.
    fn writer(&mut self, base: &str) {
        use Flow::{Egress, Ingress};
        self.add(Ingress, "put", format!("{base}/data/*"));
        self.add(Ingress, "put", format!("{base}/history/*/*"));
        self.add(Ingress, "liveliness_token", format!("{base}/writer/**"));
        self.add(Ingress, "liveliness_query", format!("{base}/**"));
        self.add(Ingress, "declare_liveliness_subscriber", format!("{base}/reader/**"));
        self.add(Ingress, "declare_subscriber", format!("{base}/room/*/*"));
        self.add(Ingress, "declare_queryable", format!("{base}/join/*"));
        self.add(Ingress, "query", format!("{base}/join/*"));
        self.add(Egress, "put", format!("{base}/room/*/*"));
        self.add(Egress, "liveliness_token", format!("{base}/**"));
        self.add(Egress, "query", format!("{base}/join/*"));
    }

    /// What a reader of the topic with this `base` does and is told.
    fn reader(&mut self, base: &str) {
        use Flow::{Egress, Ingress};
        self.add(Ingress, "put", format!("{base}/room/*/*"));
        self.add(Ingress, "liveliness_token", format!("{base}/reader/**"));
        self.add(Ingress, "liveliness_query", format!("{base}/**"));
        self.add(Ingress, "declare_subscriber", format!("{base}/data/*"));
        self.add(Ingress, "declare_subscriber", format!("{base}/history/*/*"));
        self.add(Ingress, "query", format!("{base}/join/*"));
        self.add(Egress, "put", format!("{base}/data/*"));
        self.add(Egress, "put", format!("{base}/history/*/*"));
        self.add(Egress, "liveliness_token", format!("{base}/**"));
    }

    /// What routers tell each other beside that: who listens where, and that they are there.
    fn host(&mut self, graph: &str, role: Role) {
        use Flow::{Egress, Ingress};
        self.add(Ingress, "liveliness_token", ROUTERS);
        for topic in role.hears() {
            self.add(Ingress, "declare_liveliness_subscriber", format!("{}/writer/**", base(graph, *topic)));
        }
        for message in ["declare_subscriber", "declare_queryable", "liveliness_query", "declare_liveliness_subscriber"] {
            self.add(Egress, message, format!("coxswain-link/{graph}/**"));
        }
        for message in ["liveliness_query", "declare_liveliness_subscriber"] {
            self.add(Egress, message, ROUTERS);
        }
    }

    /// One rule for each kind of message and way.
    fn rules(&self, role: &str) -> Vec<Value> {
        let mut rules = Vec::new();
        for (flow, name) in [(Flow::Ingress, "ingress"), (Flow::Egress, "egress")] {
            for message in ALL_MESSAGES {
                let mut keys: Vec<&str> =
                    self.0.iter().filter(|(way, kind, _)| (*way, *kind) == (flow, message)).map(|(_, _, key)| key.as_str()).collect();
                keys.sort_unstable();
                keys.dedup();
                if !keys.is_empty() {
                    let id = format!("{role} {name} {message}");
                    rules.push(json!({ "id": id, "messages": [message], "flows": [name], "permission": "allow", "key_exprs": keys }));
                }
            }
        }
        rules
    }
}

fn base(graph: &str, topic: Topic) -> String {
    format!("coxswain-link/{graph}/{}", topic.name())
}

/// What `role` may do at the router of a graph.
fn on_links(role: Role, graph: &str) -> Allowed {
    let mut allowed = Allowed::default();
    for topic in role.says() {
        allowed.writer(&base(graph, *topic));
    }
    for topic in role.hears() {
        allowed.reader(&base(graph, *topic));
    }
    if role != Role::Watcher {
        allowed.add(Flow::Ingress, "liveliness_query", ROUTERS);
        allowed.add(Flow::Ingress, "declare_liveliness_subscriber", ROUTERS);
        allowed.add(Flow::Egress, "liveliness_token", ROUTERS);
    }
    if role.is_host() {
        allowed.host(graph, role);
    }
    allowed
}

/// Access control from what each role may do; who is no such role of `robot` may nothing.
fn control(robot: &str, roles: impl IntoIterator<Item = (Role, Allowed)>) -> Value {
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for (role, allowed) in roles {
        let own = allowed.rules(role.name());
        if own.is_empty() {
            continue;
        }
        let ids: Vec<Value> = own.iter().map(|rule| rule["id"].clone()).collect();
        subjects.push(json!({ "id": role.name(), "link_protocols": ["tls"], "cert_common_names": [role.subject(robot)] }));
        policies.push(json!({ "rules": ids, "subjects": [role.name()] }));
        rules.extend(own);
    }
    json!({ "enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies })
}

/// For the router of the graph called `graph` on the network.
pub(crate) fn of_links(graph: &str, robot: &str) -> Value {
    control(robot, Role::ALL.map(|role| (role, on_links(role, graph))))
}

/// For a client of such a router, which believes nobody else.
pub(crate) fn of_client(robot: &str) -> Value {
    control(robot, [Role::RobotHost, Role::ControlHost].map(|role| (role, everything())))
}

/// For the gateway of `robot`, as zenoh's `access_control`: watchers hear what it says, and nothing else passes.
pub fn of_telemetry(robot: &str) -> Value {
    let mut allowed = Allowed::default();
    for key in ["coxswain/*/*", "coxswain/*/*/json"] {
        allowed.add(Flow::Ingress, "declare_subscriber", key);
        allowed.add(Flow::Egress, "put", key);
    }
    control(robot, [(Role::Watcher, allowed)])
}

/// For a watcher, which believes the gateway of its robot alone.
pub(crate) fn of_watcher(robot: &str) -> Value {
    control(robot, [(Role::Gateway, everything())])
}

fn everything() -> Allowed {
    let mut allowed = Allowed::default();
    for message in ALL_MESSAGES {
        allowed.add(Flow::Ingress, message, "**");
        allowed.add(Flow::Egress, message, "**");
    }
    allowed
}

/// Longest messages that a router takes in.
pub(crate) fn size_limits(graph: &str) -> Value {
    let keys: Vec<_> = Topic::ALL.iter().map(|topic| format!("{}/**", base(graph, *topic))).collect();
    json!([{
        "id": "links",
        "messages": ["put", "delete", "query", "reply"],
        "flows": ["ingress"],
        "key_exprs": keys,
        "size_limit": PUT_BYTES_MAX,
    }])
}
