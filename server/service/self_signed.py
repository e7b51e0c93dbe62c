"""A TLS certificate of one's own making, for a studio's network: browsers ask once whether to trust it."""

from __future__ import annotations

import datetime
import ipaddress
import socket
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from streamlod.core.files import write_bytes

_DAYS = 397  # that browsers accept at most
_SKEW = datetime.timedelta(days=1)  # that a phone's clock may be behind


def write_self_signed(certificate: Path, key: Path, address: str) -> None:
    """Write a certificate and its key (PEM) for this machine at an IP address of its own; the key is this user's alone.

    Raises:
        InputError: a file cannot be written.
    """
    secret = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "streamlod")])
    places: list[x509.GeneralName] = [x509.IPAddress(ipaddress.ip_address(each)) for each in {address, "127.0.0.1"}]
    places += [x509.DNSName("localhost"), x509.DNSName(socket.gethostname())]
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(secret.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + datetime.timedelta(days=_DAYS))
        .add_extension(x509.SubjectAlternativeName(places), critical=False)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(secret, hashes.SHA256())
    )
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    write_bytes(key, secret.private_bytes(serialization.Encoding.PEM, *form), private=True)
    write_bytes(certificate, made.public_bytes(serialization.Encoding.PEM))
