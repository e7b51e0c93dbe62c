"""TLS: certificates are renewed whole or not at all, and handshakes that never end cost little and not for long."""

from __future__ import annotations

import logging
import shutil
import socket
import ssl
from contextlib import ExitStack
from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from streamlod.server.http.tls import Certificates
from streamlod.server.service.run import certificates_of
from streamlod.server.settings import Limits, Settings
from tests.server.auth.test_gate import serial_at, write_certificate
from tests.server.conftest import Running, running
from tests.waiting import wait


def secured(folder: Path, **limits: float) -> Settings:
    certificate, key = write_certificate(folder, 1001)
    return Settings(certificate=certificate, certificate_key=key, limits=Limits.model_validate(limits))


def _upgrade(socket_name: str) -> bytes:
    """Ask for a websocket of a stream that there may be."""
    lines = (f"GET /v1/streams/main/{socket_name} HTTP/1.1", "Host: a", "Upgrade: websocket", "Connection: Upgrade",
             "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", "", "")  # fmt: skip
    return "\r\n".join(lines).encode()


def silent(server: Running) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), 10)


def is_closed(peer: socket.socket, seconds: float) -> bool:
    """Whether the server ends a connection within a time."""
    peer.settimeout(seconds)
    try:
        return peer.recv(100) == b""
    except TimeoutError:
        return False
    except ConnectionError:
        return True


@pytest.mark.parametrize("lost", ["key of before", "certificate of before", "no key", "no certificate", "garbage"])
def test_half_a_rotation_changes_nothing(tmp_path: Path, lost: str) -> None:
    """Also for connections after it: what is tried is no part of what is served."""
    other = tmp_path / "other"
    other.mkdir()
    new_certificate, new_key = write_certificate(other, 1002)
    settings = secured(tmp_path)
    assert settings.certificate is not None
    assert settings.certificate_key is not None
    certificates = certificates_of(settings)
    assert certificates is not None
    before = certificates.context
    match lost:
        case "key of before":
            shutil.copy(new_certificate, settings.certificate)
        case "certificate of before":
            shutil.copy(new_key, settings.certificate_key)
        case "no key":
            settings.certificate_key.unlink()
        case "no certificate":
            settings.certificate.unlink()
        case "garbage":
            settings.certificate_key.write_text("nothing")
    with pytest.raises(InputError, match="belong together"):
        certificates.reload()
    assert certificates.context is before
    shutil.copy(new_certificate, settings.certificate)
    shutil.copy(new_key, settings.certificate_key)
    certificates.reload()
    assert certificates.context is not before


def test_a_key_with_a_password_is_refused_instead_of_asking_for_it(tmp_path: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, PrivateFormat

    certificate, key = write_certificate(tmp_path, 1)
    sealed = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")
    )
    key.write_bytes(sealed)
    with pytest.raises(InputError, match="the key is encrypted"):
        Certificates(certificate, key)


def test_silent_handshakes_end(tmp_path: Path) -> None:
    with running(secured(tmp_path, request_seconds=1.0)) as server, silent(server) as peer:
        assert is_closed(peer, 60)
        wait(lambda: server.registry.turned_away["handshakes"] == 1)
        assert serial_at(server.port) == 1001


def test_one_address_gets_only_so_many_handshakes(tmp_path: Path) -> None:
    """Those beyond are ended at once, and not at the deadline, which never comes here."""
    with running(secured(tmp_path, handshakes_per_address=3, request_seconds=600.0)) as server, ExitStack() as stack:
        kept = [stack.enter_context(silent(server)) for _ in range(3)]
        beyond = [stack.enter_context(silent(server)) for _ in range(17)]
        assert all(is_closed(peer, 60) for peer in beyond)
        wait(lambda: server.registry.turned_away["handshakes"] == 17)
        assert not any(is_closed(peer, 0.02) for peer in kept)


def test_bytes_that_are_no_handshake_are_cut_off(tmp_path: Path) -> None:
    with running(secured(tmp_path)) as server, silent(server) as peer:
        peer.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        while peer.recv(100):
            pass
        wait(lambda: server.registry.turned_away["handshakes"] == 1)
        assert serial_at(server.port) == 1001


@pytest.mark.parametrize("asks", [b"GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n", _upgrade("live"), _upgrade("ingest")])
def test_the_end_waits_for_no_goodbye(tmp_path: Path, caplog: pytest.LogCaptureFixture, asks: bytes) -> None:
    """A phone that sleeps, or a browser that keeps a connection for later, answers no end of TLS; all went well."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with ExitStack() as peers, running(secured(tmp_path)) as server:
        peer = peers.enter_context(context.wrap_socket(peers.enter_context(silent(server))))
        peer.sendall(asks)
        assert b"HTTP/1.1 " in peer.recv(1000)
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR] == []
