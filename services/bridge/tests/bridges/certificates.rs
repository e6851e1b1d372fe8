//! An authority and the certificates that it signs, as files.

use crate::hosts::Failure;
use access::{AUTHORITY_FILE, CERTIFICATE_FILE, Credentials, KEY_FILE, Role};
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose, date_time_ymd,
};
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use tempfile::TempDir;

/// Robot of all certificates.
const ROBOT: &str = "test";

pub(crate) struct Authority {
    issuer: Issuer<'static, KeyPair>,
    certificate: String,
    home: TempDir,
}

impl Authority {
    pub(crate) fn new() -> Result<Self, Failure> {
        let mut params = params("authority".to_owned(), &[])?;
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages.push(KeyUsagePurpose::KeyCertSign);
        let key = KeyPair::generate()?;
        let certificate = params.self_signed(&key)?.pem();
        let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        Ok(Self { issuer: Issuer::new(params, key), certificate, home })
    }

    /// A certificate of `role`. It is made once.
    pub(crate) fn of(&self, role: &Role) -> Result<Credentials, Failure> {
        let folder = self.home.path().join(role.to_string());
        let credentials = Credentials::in_folder(&folder);
        if folder.exists() {
            return Ok(credentials);
        }
        fs::create_dir(&folder)?;
        let addresses: &[&str] = if role.serves() { &["127.0.0.1"] } else { &[] };
        let mut params = params(role.subject(ROBOT), addresses)?;
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ClientAuth, ExtendedKeyUsagePurpose::ServerAuth];
        let key = KeyPair::generate()?;
        let signed = params.signed_by(&key, &self.issuer)?.pem();
        for (name, text) in [
            (CERTIFICATE_FILE, signed),
            (KEY_FILE, key.serialize_pem()),
            (AUTHORITY_FILE, self.certificate.clone()),
        ] {
            let mut file = OpenOptions::new()
                .write(true)
                .create_new(true)
                .mode(0o600)
                .open(folder.join(name))?;
            file.write_all(text.as_bytes())?;
        }
        Ok(credentials)
    }

    /// The certificate of the host `name`.
    pub(crate) fn of_host(&self, name: &str) -> Result<Credentials, Failure> {
        self.of(&Role::Host(name.to_owned()))
    }
}

fn params(subject: String, addresses: &[&str]) -> Result<CertificateParams, Failure> {
    let addresses: Vec<String> = addresses.iter().map(|&address| address.to_owned()).collect();
    let mut params = CertificateParams::new(addresses)?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, subject);
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    (params.not_before, params.not_after) = (date_time_ymd(2000, 1, 1), date_time_ymd(2100, 1, 1));
    Ok(params)
}
