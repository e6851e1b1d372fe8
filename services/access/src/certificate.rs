//! The contents of a certificate: role and robot of its holder, validity, and the addresses where
//! the holder accepts connections.

use super::Role;
use std::net::IpAddr;
use x509_parser::extensions::GeneralName;
use x509_parser::pem::parse_x509_pem;
use x509_parser::prelude::X509Certificate;

/// The parts of a certificate that the graph uses. TLS judges whether it is genuine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Certificate {
    /// Role of the holder.
    pub role: Role,
    /// Robot of the holder.
    pub robot: String,
    /// Start of its validity: Unix time \[s\].
    pub from_s: i64,
    /// End of its validity: Unix time \[s\].
    pub until_s: i64,
    /// Names and addresses where its holder accepts connections.
    pub addresses: Vec<String>,
}

impl Certificate {
    /// Reads the first certificate of a PEM file. On failure it returns the reason.
    ///
    /// # Errors
    /// A sentence with the reason.
    pub fn parse(pem: &[u8]) -> Result<Self, String> {
        let (_, pem) = parse_x509_pem(pem).map_err(|_| "it is not a PEM file".to_owned())?;
        let certificate = pem.parse_x509().map_err(|_| "it contains no certificate".to_owned())?;
        let name = certificate
            .subject()
            .iter_common_name()
            .next()
            .and_then(|name| name.as_str().ok())
            .unwrap_or_default();
        let parts = name
            .split_once('.')
            .and_then(|(role, robot)| Some((Role::named(role)?, robot.to_owned())));
        let (role, robot) =
            parts.ok_or_else(|| format!("its subject {name:?} names no role and robot"))?;
        let validity = certificate.validity();
        let (from_s, until_s) = (validity.not_before.timestamp(), validity.not_after.timestamp());
        Ok(Self { role, robot, from_s, until_s, addresses: addresses(&certificate) })
    }

    /// Whether the certificate is valid for a connection to `host`, a name or an address.
    pub fn covers(&self, host: &str) -> bool {
        let host = host.trim_start_matches('[').trim_end_matches(']');
        let ip = host.parse::<IpAddr>().ok();
        self.addresses.iter().any(|address| match ip {
            Some(ip) => address.parse() == Ok(ip),
            None => address.eq_ignore_ascii_case(host),
        })
    }
}

/// End of validity of the first certificate of a PEM file, of any holder: Unix time \[s\].
///
/// # Errors
/// A sentence with the reason.
pub fn valid_until(pem: &[u8]) -> Result<i64, String> {
    let (_, pem) = parse_x509_pem(pem).map_err(|_| "it is not a PEM file".to_owned())?;
    let certificate = pem.parse_x509().map_err(|_| "it contains no certificate".to_owned())?;
    Ok(certificate.validity().not_after.timestamp())
}

fn addresses(certificate: &X509Certificate<'_>) -> Vec<String> {
    let names = certificate.subject_alternative_name().ok().flatten();
    let names = names.iter().flat_map(|extension| extension.value.general_names.iter());
    names
        .filter_map(|name| match name {
            GeneralName::DNSName(name) => Some((*name).to_owned()),
            GeneralName::IPAddress(bytes) => <[u8; 4]>::try_from(*bytes)
                .map(IpAddr::from)
                .or_else(|_| <[u8; 16]>::try_from(*bytes).map(IpAddr::from))
                .ok()
                .map(|ip| ip.to_string()),
            _ => None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invalid_certificate_is_refused_with_a_reason() {
        assert_eq!(Certificate::parse(b"hello"), Err("it is not a PEM file".to_owned()));
        let empty = b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
        assert_eq!(Certificate::parse(empty), Err("it contains no certificate".to_owned()));
    }

    #[test]
    fn an_address_is_covered_however_it_is_written() {
        let addresses = ["localhost", "10.0.0.1", "::1"].map(str::to_owned).to_vec();
        let certificate =
            Certificate { role: Role::Driver, robot: "r".into(), from_s: 0, until_s: 0, addresses };
        assert!(
            ["LocalHost", "10.0.0.1", "[::1]", "0:0:0:0:0:0:0:1"]
                .into_iter()
                .all(|host| certificate.covers(host))
        );
        assert!(
            !["10.0.0.2", "localhost.example", ""].into_iter().any(|host| certificate.covers(host))
        );
    }
}
