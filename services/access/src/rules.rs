//! Who connects → zenoh's access control: a peer that is not named is denied everything.
//!
//! zenoh judges each message twice: where it arrives and where it leaves.

use super::Role;
use serde_json::{Value, json};

/// For the session of a bridge with one other machine: only the holder of the certificate with
/// `subject` publishes and subscribes, below the keys of `graph`.
pub fn of_bridge(graph: &str, subject: &str) -> Value {
    let keys = [format!("coxswain-link/{graph}/**")];
    let rules = [
        json!({
            "id": "publish",
            "messages": ["put"],
            "flows": ["ingress", "egress"],
            "permission": "allow",
            "key_exprs": keys,
        }),
        json!({
            "id": "subscribe",
            "messages": ["declare_subscriber"],
            "flows": ["ingress", "egress"],
            "permission": "allow",
            "key_exprs": keys,
        }),
    ];
    control(subject, &rules)
}

/// For the gateway of `robot`: watchers receive what it publishes, and nothing else passes.
pub fn of_telemetry(robot: &str) -> Value {
    let keys = ["coxswain/*/*", "coxswain/*/*/json"];
    let rules = [
        json!({
            "id": "subscribe",
            "messages": ["declare_subscriber"],
            "flows": ["ingress"],
            "permission": "allow",
            "key_exprs": keys,
        }),
        json!({
            "id": "receive",
            "messages": ["put"],
            "flows": ["egress"],
            "permission": "allow",
            "key_exprs": keys,
        }),
    ];
    control(&Role::Watcher.subject(robot), &rules)
}

/// For the bridge of a host, where operators and planners of `robot` send requests: each role
/// queries below its own key, and gets replies. Nothing else passes.
pub fn of_requests(robot: &str) -> Value {
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for role in [Role::Operator, Role::Planner] {
        let keys = [format!("coxswain-request/{robot}/{role}/*")];
        for (kind, flow) in
            [("query", "ingress"), ("reply", "egress"), ("declare_queryable", "egress")]
        {
            rules.push(json!({
                "id": format!("{role} {kind}"),
                "messages": [kind],
                "flows": [flow],
                "permission": "allow",
                "key_exprs": keys,
            }));
        }
        let ids = ["query", "reply", "declare_queryable"].map(|kind| format!("{role} {kind}"));
        subjects.push(json!({
            "id": role.to_string(),
            "link_protocols": ["tls"],
            "cert_common_names": [role.subject(robot)],
        }));
        policies.push(json!({ "rules": ids, "subjects": [role.to_string()] }));
    }
    denying(&rules, &subjects, &policies)
}

/// For a gateway without certificates: every peer may subscribe, and no message with data passes.
pub fn of_open_telemetry() -> Value {
    json!({
        "enabled": true,
        "default_permission": "allow",
        "rules": [{
            "id": "read only",
            "messages": [
                "put", "delete", "query", "reply", "declare_queryable", "liveliness_token",
            ],
            "flows": ["ingress"],
            "permission": "deny",
            "key_exprs": ["**"],
        }],
        "subjects": [{ "id": "anyone" }],
        "policies": [{ "rules": ["read only"], "subjects": ["anyone"] }],
    })
}

/// For a plain zenoh router at which the bridges of `robot` meet: each host publishes below its own
/// key prefix alone, and subscribes to what is sent to it.
pub fn of_meeting_point(graph: &str, robot: &str, hosts: &[String]) -> Value {
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for host in hosts {
        let own = format!("coxswain-link/{graph}/{host}/**");
        let incoming = format!("coxswain-link/{graph}/*/{host}/**");
        let ids = [("publish", own), ("receive", incoming)].map(|(what, key)| {
            let id = format!("{host} {what}");
            let (puts, declarations) =
                if what == "publish" { ("ingress", "egress") } else { ("egress", "ingress") };
            for (kind, flow) in [("put", puts), ("declare_subscriber", declarations)] {
                rules.push(json!({
                    "id": format!("{id} {kind}"),
                    "messages": [kind],
                    "flows": [flow],
                    "permission": "allow",
                    "key_exprs": [key],
                }));
            }
            id
        });
        subjects.push(json!({
            "id": host,
            "link_protocols": ["tls"],
            "cert_common_names": [Role::Host(host.clone()).subject(robot)],
        }));
        let ids: Vec<String> = ids
            .iter()
            .flat_map(|id| ["put", "declare_subscriber"].map(|kind| format!("{id} {kind}")))
            .collect();
        policies.push(json!({ "rules": ids, "subjects": [host] }));
    }
    denying(&rules, &subjects, &policies)
}

/// Denies everything but `rules` to the holder of the certificate with `subject`.
fn control(subject: &str, rules: &[Value]) -> Value {
    let ids: Vec<&Value> = rules.iter().map(|rule| &rule["id"]).collect();
    let subject = json!({
        "id": "peer",
        "link_protocols": ["tls"],
        "cert_common_names": [subject],
    });
    denying(rules, &[subject], &[json!({ "rules": ids, "subjects": ["peer"] })])
}

/// Denies everything but what the policies say.
fn denying(rules: &[Value], subjects: &[Value], policies: &[Value]) -> Value {
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}
