//! Roles → zenoh's access control: an unnamed peer is denied everything, and a named role is
//! allowed only what its topics need.
//!
//! zenoh judges each message twice: where it arrives and where it leaves. A message is allowed if a
//! rule of its sender's (or receiver's) role has a key expression that includes the message's own.

use super::Role;
use protocol::topic::{Quality, Topic};
use serde_json::{Value, json};

/// Keys of the tokens that identify routers.
const ROUTERS: &str = "coxswain-router/*";

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

/// Direction of a message, as its router sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Flow {
    Ingress,
    Egress,
}

/// Reader that the self-test of a router addresses, so that no other reader receives the test.
pub const TESTER: &str = "self-test";

/// What one role may do.
#[derive(Debug, Default)]
struct Allowed(Vec<(Flow, &'static str, String)>);

impl Allowed {
    fn add(&mut self, flow: Flow, message: &'static str, key: impl Into<String>) {
        self.0.push((flow, message, key.into()));
    }

    /// Allows what a writer of the topic with this `base` sends and receives. The names of writers
    /// begin with their roles; other names are refused.
    fn writer(&mut self, base: &str, roles: &[Role], quality: Quality) {
        use Flow::{Egress, Ingress};
        for role in roles {
            self.add(Ingress, "put", format!("{base}/data/{}.$*", role.name()));
            if quality.says_again() {
                self.add(Ingress, "put", format!("{base}/history/*/{}.$*", role.name()));
            }
        }
        self.add(Ingress, "liveliness_token", format!("{base}/writer/**"));
        self.add(Ingress, "liveliness_query", format!("{base}/**"));
        self.add(Ingress, "declare_liveliness_subscriber", format!("{base}/reader/**"));
        self.add(Ingress, "declare_queryable", format!("{base}/join/*"));
        self.add(Ingress, "query", format!("{base}/join/*"));
        if quality.is_paced() {
            self.add(Ingress, "declare_subscriber", format!("{base}/room/*/*"));
            self.add(Egress, "put", format!("{base}/room/*/*"));
        }
        self.add(Egress, "liveliness_token", format!("{base}/**"));
        self.add(Egress, "query", format!("{base}/join/*"));
    }

    /// Allows what a reader of the topic with this `base` sends and receives.
    fn reader(&mut self, base: &str, quality: Quality) {
        use Flow::{Egress, Ingress};
        if quality.is_paced() {
            self.add(Ingress, "put", format!("{base}/room/*/*"));
        }
        self.add(Ingress, "liveliness_token", format!("{base}/reader/**"));
        self.add(Ingress, "liveliness_query", format!("{base}/**"));
        self.add(Ingress, "query", format!("{base}/join/*"));
        for key in
            [Some("data/*"), quality.says_again().then_some("history/*/*")].into_iter().flatten()
        {
            self.add(Ingress, "declare_subscriber", format!("{base}/{key}"));
            self.add(Egress, "put", format!("{base}/{key}"));
        }
        self.add(Egress, "liveliness_token", format!("{base}/**"));
    }

    /// Allows what routers exchange beside that: the readers behind each router, and that the
    /// router is alive.
    fn host(&mut self, graph: &str, role: Role) {
        use Flow::{Egress, Ingress};
        self.add(Ingress, "liveliness_token", ROUTERS);
        for topic in role.hears() {
            self.add(
                Ingress,
                "declare_liveliness_subscriber",
                format!("{}/writer/**", base(graph, *topic)),
            );
        }
        for message in [
            "declare_subscriber",
            "declare_queryable",
            "liveliness_query",
            "declare_liveliness_subscriber",
        ] {
            self.add(Egress, message, format!("coxswain-link/{graph}/**"));
        }
        for message in ["liveliness_query", "declare_liveliness_subscriber"] {
            self.add(Egress, message, ROUTERS);
        }
    }

    /// Allows what a host's router sends to itself in its self-test, on the topic with this `base`.
    fn tester(&mut self, base: &str, role: Role) {
        use Flow::{Egress, Ingress};
        self.add(Ingress, "put", format!("{base}/history/{TESTER}/{}.$*", role.name()));
        self.add(Ingress, "declare_subscriber", format!("{base}/history/{TESTER}/*"));
        self.add(Egress, "put", format!("{base}/history/{TESTER}/*"));
    }

    /// One rule for each kind of message and direction.
    fn rules(&self, role: &str) -> Vec<Value> {
        let mut rules = Vec::new();
        for (flow, name) in [(Flow::Ingress, "ingress"), (Flow::Egress, "egress")] {
            for message in ALL_MESSAGES {
                let mut keys: Vec<&str> = self
                    .0
                    .iter()
                    .filter(|(way, kind, _)| (*way, *kind) == (flow, message))
                    .map(|(_, _, key)| key.as_str())
                    .collect();
                keys.sort_unstable();
                keys.dedup();
                if !keys.is_empty() {
                    let id = format!("{role} {name} {message}");
                    rules.push(json!({
                        "id": id,
                        "messages": [message],
                        "flows": [name],
                        "permission": "allow",
                        "key_exprs": keys,
                    }));
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
fn on_links(role: Role, graph: &str, lock_step: bool) -> Allowed {
    let mut allowed = Allowed::default();
    for topic in role.says() {
        allowed.writer(&base(graph, *topic), &role.brings(*topic), topic.quality(lock_step));
    }
    for topic in role.hears() {
        allowed.reader(&base(graph, *topic), topic.quality(lock_step));
    }
    if role != Role::Watcher {
        allowed.add(Flow::Ingress, "liveliness_query", ROUTERS);
        allowed.add(Flow::Ingress, "declare_liveliness_subscriber", ROUTERS);
        allowed.add(Flow::Egress, "liveliness_token", ROUTERS);
    }
    if role.is_host() {
        allowed.host(graph, role);
        allowed.tester(&base(graph, Topic::Health), role);
    }
    allowed
}

/// Denies `role` everything. zenoh logs what it refuses to a role only if a rule names that role.
fn nothing(role: &str) -> Value {
    let (id, flows) = (format!("{role} nothing"), ["ingress", "egress"]);
    json!({
        "id": id,
        "messages": ALL_MESSAGES,
        "flows": flows,
        "permission": "deny",
        "key_exprs": ["**"],
    })
}

/// Access control from what each role may do. A peer whose role of `robot` is not among them is
/// denied everything.
fn control(robot: &str, roles: impl IntoIterator<Item = (Role, Allowed)>) -> Value {
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for (role, allowed) in roles {
        let mut own = allowed.rules(role.name());
        if own.is_empty() {
            own.push(nothing(role.name()));
        }
        let ids: Vec<Value> = own.iter().map(|rule| rule["id"].clone()).collect();
        subjects.push(json!({
            "id": role.name(),
            "link_protocols": ["tls"],
            "cert_common_names": [role.subject(robot)],
        }));
        policies.push(json!({ "rules": ids, "subjects": [role.name()] }));
        rules.extend(own);
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

/// For the router of the graph called `graph` on the network.
pub fn of_links(graph: &str, robot: &str, lock_step: bool) -> Value {
    control(robot, Role::ALL.map(|role| (role, on_links(role, graph, lock_step))))
}

/// For a client of such a router, which trusts no other peer.
pub fn of_client(robot: &str) -> Value {
    control(robot, [Role::RobotHost, Role::ControlHost].map(|role| (role, everything())))
}

/// For the gateway of `robot`, as zenoh's `access_control`: watchers receive what it publishes, and
/// nothing else passes.
pub fn of_telemetry(robot: &str) -> Value {
    let mut allowed = Allowed::default();
    for key in ["coxswain/*/*", "coxswain/*/*/json"] {
        allowed.add(Flow::Ingress, "declare_subscriber", key);
        allowed.add(Flow::Egress, "put", key);
    }
    let of = |role| {
        (
            role,
            if role == Role::Watcher { std::mem::take(&mut allowed) } else { Allowed::default() },
        )
    };
    control(robot, Role::ALL.map(of))
}

/// For a watcher, which trusts the gateway of its robot alone.
pub fn of_watcher(robot: &str) -> Value {
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

/// Messages of one role that pass on one topic and link in real time \[1/s\]. The gap between two
/// of them is at least the inverse of this. It is five times what the shortest period needs.
/// Repetitions for readers that join are counted apart.
const PER_SECOND: u32 = 5_000;
/// The same for snapshots, or pieces of them, each of which has the length limit of a message: 65
/// MB/s.
const SNAPSHOTS_PER_SECOND: u32 = 1_000;

/// Rate limits per role and topic, as zenoh's `downsampling`.
pub fn gaps(graph: &str) -> Value {
    let of = |role: Role| {
        role.says().iter().flat_map(move |topic| {
            let frequency =
                if *topic == Topic::Snapshot { SNAPSHOTS_PER_SECOND } else { PER_SECOND };
            let key =
                move |place: &str| format!("{}/{place}/{}.$*", base(graph, *topic), role.name());
            ["data", "history/*"].map(|place| json!({ "key_expr": key(place), "freq": frequency }))
        })
    };
    let rules: Vec<Value> = Role::ALL.into_iter().flat_map(of).collect();
    json!([{ "id": "rates", "messages": ["put"], "flows": ["ingress"], "rules": rules }])
}

/// Fixes the quality of forwarded messages in real time, as zenoh's `qos/network`, whatever their
/// sender requested. A publication gets the `priority` of its topic, queries go behind everything,
/// and no sender is waited for. Without this, a sender that floods one topic as urgent delays all
/// others. A sender that requests blocking would end the links of slow receivers.
pub fn qualities(graph: &str, priority: fn(Topic) -> &'static str) -> Value {
    let published = |topic: Topic| {
        let base = base(graph, topic);
        json!({
            "id": topic.name(),
            "messages": ["put", "delete"],
            "flows": ["ingress"],
            "key_exprs": [format!("{base}/data/*"), format!("{base}/history/*/*")],
            "overwrite": {
                "priority": priority(topic),
                "congestion_control": "drop",
                "express": false,
            },
        })
    };
    let asked = json!({
        "id": "questions",
        "messages": ["query"],
        "flows": ["ingress"],
        "overwrite": { "priority": "background", "congestion_control": "drop", "express": false },
    });
    Value::Array(Topic::ALL.map(published).into_iter().chain([asked]).collect())
}
