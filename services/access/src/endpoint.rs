//! Endpoints: the hosts that they name.

use std::net::IpAddr;

/// The host of `tls/10.0.0.1:7447`.
pub fn host_in(endpoint: &str) -> &str {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    host.trim_start_matches('[').trim_end_matches(']')
}

/// Whether a host stands for every address of the machine.
pub fn is_any(host: &str) -> bool {
    host.parse::<IpAddr>().is_ok_and(|ip| ip.is_unspecified())
}

/// Endpoint by which the processes of this machine reach a router that listens at `endpoint`. No
/// certificate covers an address that stands for all.
pub fn from_here(endpoint: &str) -> String {
    let host = host_in(endpoint);
    if is_any(host) {
        endpoint.replacen(&format!("/{host}:"), "/127.0.0.1:", 1).replacen(
            "/[::]:",
            "/127.0.0.1:",
            1,
        )
    } else {
        endpoint.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_reaches_itself_by_an_address_that_a_certificate_can_name() {
        for (endpoint, reached) in [
            ("tls/0.0.0.0:7447", "tls/127.0.0.1:7447"),
            ("tls/[::]:7447", "tls/127.0.0.1:7447"),
            ("tls/10.0.0.1:7447", "tls/10.0.0.1:7447"),
            ("tls/localhost:1", "tls/localhost:1"),
        ] {
            assert_eq!(from_here(endpoint), reached);
        }
    }
}
