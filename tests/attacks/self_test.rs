//! A router that keeps nobody out is found out before anything depends on it.

use crate::session::{Certificates, Shows, router};
use promises::Outcome;
use protocol::access::Role;
use protocol::port::{Breach, Router, self_test};
use serde_json::json;

const GRAPH: &str = "maze";

#[test]
fn a_router_as_it_should_be_passes_its_self_test() -> Outcome {
    let certificates = Certificates::new()?;
    for role in [Role::RobotHost, Role::ControlHost] {
        for lock_step in [false, true] {
            Router::guarded(&["tcp/127.0.0.1:0".to_owned()], &[], GRAPH, &certificates.of(role), lock_step)?.self_test()?;
        }
    }
    Ok(())
}

#[test]
fn a_router_that_is_configured_wrongly_is_not_relied_on() -> Outcome {
    let certificates = Certificates::new()?;
    let credentials = certificates.of(Role::RobotHost);
    let tested = |shows: Shows, more: &[(&str, serde_json::Value)]| -> Result<Option<Breach>, Box<dyn std::error::Error>> {
        let (_session, endpoint) = router(&shows, more)?;
        Ok(self_test(&endpoint, GRAPH, &credentials).err())
    };
    let plain = tested(Shows::Nothing, &[])?;
    assert!(matches!(plain, Some(Breach::Plain { .. })), "{plain:?}");
    let asks_for_none = tested(Shows::NoCertificate(credentials.clone()), &[])?;
    assert!(matches!(asks_for_none, Some(Breach::NoCertificate { .. })), "{asks_for_none:?}");
    let no_roles = tested(Shows::Certificate(credentials.clone()), &[])?;
    assert!(matches!(no_roles, Some(Breach::WrongRole { role: "robot-host", topic: "command", .. })), "{no_roles:?}");
    let deny = json!({
        "enabled": true,
        "default_permission": "allow",
        "rules": [{ "id": "r", "messages": ["put"], "flows": ["ingress"], "permission": "deny", "key_exprs": ["coxswain-link/*/command/**"] }],
        "subjects": [{ "id": "s" }],
        "policies": [{ "rules": ["r"], "subjects": ["s"] }],
    });
    let any_length = tested(Shows::Certificate(credentials.clone()), &[("access_control", deny)])?;
    assert!(matches!(any_length, Some(Breach::Oversize { .. })), "{any_length:?}");
    let nobody = self_test("tls/127.0.0.1:1", GRAPH, &credentials);
    assert!(matches!(nobody, Err(Breach::Unknown { .. })), "{nobody:?}");
    Ok(())
}
