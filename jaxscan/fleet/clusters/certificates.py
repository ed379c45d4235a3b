"""Certificates of a cluster: who holds one may connect, and nobody else.

An authority is made, signs one certificate, and its key is thrown away: no second certificate can ever be made. All
processes of the cluster share that one, and each asks the other side for it (mutual TLS).
"""

import datetime
import os
from pathlib import Path
from typing import Any, NamedTuple

from jaxscan.errors import DependencyError, OutputError
from jaxscan.files.disk import make_folder, reported, shown, write_atomically


DAYS = 30
"""How long they are good for; a batch that lasts longer is called again."""
_CLOCKS_APART = datetime.timedelta(hours=1)
NAMES = ("ca.pem", "cert.pem", "key.pem")


class Certificates(NamedTuple):
    """Three PEM texts, or the paths of the files that hold them."""

    ca: str
    cert: str
    key: str


def new_certificates(days: int = DAYS) -> Certificates:
    """An authority and a certificate of a cluster, as PEM texts in memory.

    Args:
        days: How long they are good for.

    Raises:
        DependencyError: If cryptography is not installed.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
    except ImportError as problem:
        raise DependencyError('Certificates need cryptography: pip install "jaxscan[fleet]"') from problem

    def named(name: str) -> Any:
        return x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, name)])

    now = datetime.datetime.now(datetime.UTC)
    ca_key, key = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())

    def signed(subject: str, public: Any, *, authority: bool) -> Any:
        usage = x509.KeyUsage(
            digital_signature=not authority,
            key_cert_sign=authority,
            crl_sign=authority,
            content_commitment=False,
            key_encipherment=False,
            data_encipherment=False,
            key_agreement=False,
            encipher_only=False,
            decipher_only=False,
        )
        builder = (
            x509.CertificateBuilder()
            .subject_name(named(subject))
            .issuer_name(named("jaxscan authority"))
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - _CLOCKS_APART)
            .not_valid_after(now + datetime.timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True)
            .add_extension(usage, critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(ca_key.public_key()), critical=False)
        )
        if not authority:
            names = x509.SubjectAlternativeName([x509.DNSName("jaxscan-cluster")])
            both = x509.ExtendedKeyUsage(
                [x509.oid.ExtendedKeyUsageOID.SERVER_AUTH, x509.oid.ExtendedKeyUsageOID.CLIENT_AUTH]
            )
            builder = builder.add_extension(names, critical=False).add_extension(both, critical=False)
        return builder.sign(ca_key, hashes.SHA256())

    ca = signed("jaxscan authority", ca_key.public_key(), authority=True)
    cert = signed("jaxscan cluster", key.public_key(), authority=False)
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    pem = serialization.Encoding.PEM
    return Certificates(ca.public_bytes(pem).decode(), cert.public_bytes(pem).decode(), private.decode())


def make_certificates(folder: str | Path, *, days: int = DAYS) -> Certificates:
    """Make certificates in a new folder that only its owner can read.

    Args:
        folder: The folder, which must not exist.
        days: How long they are good for.

    Returns:
        Paths of ca.pem, cert.pem and key.pem.

    Raises:
        DependencyError: If cryptography is not installed.
        OutputError: If the folder exists already, or cannot be written.
    """
    texts = new_certificates(days)
    with reported(f"{shown(folder)}: cannot be made", error=OutputError):
        make_folder(folder, new=True, mode=0o700)
    paths = paths_in(folder)
    for path, text in zip(paths, texts, strict=True):
        write_atomically(path, text.encode(), error=OutputError)
        # Nobody looks into the folder before this is done.
        os.chmod(path, 0o600)
    return paths


def paths_in(folder: str | Path) -> Certificates:
    """Where the files of a folder lie."""
    return Certificates(*(os.path.join(os.path.abspath(folder), name) for name in NAMES))


def security_of(certificates: Certificates) -> dict[str, Any]:
    """The arguments of Dask's `Security`: for each role the same certificate, and no connection without."""
    roles = ("client", "scheduler", "worker")
    return {
        "require_encryption": True,
        "tls_ca_file": certificates.ca,
        **{f"tls_{role}_cert": certificates.cert for role in roles},
        **{f"tls_{role}_key": certificates.key for role in roles},
    }
