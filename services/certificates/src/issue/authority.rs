//! The authority that signs: made once, and read again.

use super::{GROUP_AND_OTHERS, IssueError, Order, at, whole, write};
use access::{AUTHORITY_FILE, KEY_FILE, changeable, valid_until};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair, KeyUsagePurpose};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Validity of an authority \[s\]: ten years.
pub(super) const AUTHORITY_VALID_S: i64 = 3650 * 86_400;

/// Parameters of every authority.
fn authority_params() -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "Coxswain authority");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
    params
}

pub(super) fn make_authority(folder: &Path, from_s: i64) -> Result<(), IssueError> {
    let mut params = authority_params();
    (params.not_before, params.not_after) = (at(from_s), at(from_s + AUTHORITY_VALID_S));
    let key = KeyPair::generate()?;
    let certificate = params.self_signed(&key)?.pem();
    whole(folder, |half| {
        write(&half.join(KEY_FILE), &key.serialize_pem())?;
        write(&half.join(AUTHORITY_FILE), &certificate)
    })
}

/// The issuer, and its certificate as PEM.
pub(super) fn authority_in(
    folder: &Path,
    order: &Order,
) -> Result<(Issuer<'static, KeyPair>, String), IssueError> {
    let failed = |reason: String| IssueError::Authority { authority: folder.to_path_buf(), reason };
    let (key_file, certificate_file) = (folder.join(KEY_FILE), folder.join(AUTHORITY_FILE));
    let read = |path: &Path| {
        fs::read_to_string(path).map_err(|source| failed(format!("{}: {source}", path.display())))
    };
    let (key, certificate) = (read(&key_file)?, read(&certificate_file)?);
    if fs::metadata(&key_file).is_ok_and(|found| found.mode() & GROUP_AND_OTHERS != 0) {
        return Err(failed(format!(
            "{}: other users can read it; expected mode 0600",
            key_file.display()
        )));
    }
    // A file that other users may have written is not trusted.
    for path in [folder, &key_file, &certificate_file] {
        if let Some(found) =
            changeable(path).map_err(|error| failed(format!("{}: {error}", path.display())))?
        {
            return Err(failed(format!(
                "{found}: expected to be owned by this user or root, and not writable by others"
            )));
        }
    }
    let until_s = valid_until(certificate.as_bytes()).map_err(failed)?;
    if until_s < order.until_s {
        return Err(failed(
            "it expires before the certificates that it signs; make another one".to_owned(),
        ));
    }
    let key = KeyPair::from_pem(&key)
        .map_err(|error| failed(format!("its key cannot be used: {error}")))?;
    Ok((Issuer::new(authority_params(), key), certificate))
}
