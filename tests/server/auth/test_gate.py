"""Who may: keys of JSON web tokens from files and addresses, signed links, TLS and its renewal."""

from __future__ import annotations

import asyncio
import datetime
import hmac
import http.server
import json
import os
import signal
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import jwt
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from jwt.utils import base64url_encode
from websockets.sync.client import connect

from streamlod.core.errors import InputError
from streamlod.server.auth.gate import Gate, Right, hash_token
from streamlod.server.auth.keys import parse_keys
from streamlod.server.auth.links import LinkSigner
from streamlod.server.auth.secret_file import read_secret
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings, load_settings
from tests.e2e.test_server_process import serving
from tests.server.conftest import Clip, running

Private = ed25519.Ed25519PrivateKey | ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey


def public_key(private: Private, name: str) -> dict[str, Any]:
    """The public half as an entry of a key set."""
    algorithm = {"Ed": "EdDSA", "El": "ES256", "RS": "RS256"}[type(private).__name__[:2].replace("EC", "El")]
    entry: dict[str, Any] = json.loads(jwt.get_algorithm_by_name(algorithm).to_jwk(private.public_key()))
    return {**entry, "kid": name, "use": "sig"}


def token(key: Any, algorithm: str, name: str | None = None, **claims: Any) -> str:
    body = {"exp": time.time() + 60, "aud": "streamlod", "lod": {"rights": ["read"]}, **claims}
    return jwt.encode(body, key, algorithm, headers={"kid": name} if name else None)


def rights(gate: Gate, offered: str) -> set[Right] | None:
    grant = gate.grant_of(offered)
    return None if grant is None else set(grant.rights)


def test_a_key_set_holds_keys_of_several_kinds_and_each_is_used_for_one_algorithm(tmp_path: Path) -> None:
    keys: dict[str, Private] = {
        "EdDSA": ed25519.Ed25519PrivateKey.generate(),
        "ES256": ec.generate_private_key(ec.SECP256R1()),
        "RS256": rsa.generate_private_key(65537, 2048),
    }
    secret = os.urandom(40)
    entries = [public_key(key, name) for name, key in keys.items()]
    entries.append({"kty": "oct", "k": base64url_encode(secret).decode(), "kid": "HS256"})
    path = tmp_path / "keys.json"
    path.write_text(json.dumps({"keys": entries}))
    gate = Gate(Settings(jwks=str(path)))
    assert not gate.is_open
    for name, key in {**keys, "HS256": secret}.items():
        assert rights(gate, token(key, name, name)) == {Right.READ}
        assert rights(gate, token(key, name)) is None  # names no key
        assert rights(gate, token(key, name, "other")) is None
        assert rights(gate, token(key, name, name, exp=time.time() - 60)) is None
        assert rights(gate, token(key, name, name, aud="else")) is None
        assert rights(gate, token(key, name, name, lod=[])) is None
    public = (
        keys["RS256"]
        .public_key()
        .public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
    )
    forged = token(b"0" * 32, "HS256", "RS256").rpartition(".")[0]  # a public key is no secret
    signature = base64url_encode(hmac.new(public, forged.encode(), "sha256").digest()).decode()
    assert rights(gate, f"{forged}.{signature}") is None
    header = base64url_encode(b'{"alg":"none","kid":"RS256"}').decode()
    assert rights(gate, f"{header}.{token(secret, 'HS256').split('.')[1]}.") is None


def test_key_files_are_secrets_or_ed25519_keys(tmp_path: Path) -> None:
    private, path = ed25519.Ed25519PrivateKey.generate(), tmp_path / "key"
    pem = private.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    path.write_bytes(pem)
    gate = Gate(Settings(jwt_key=path))
    assert rights(gate, token(private, "EdDSA")) == rights(gate, token(private, "EdDSA", "any")) == {Right.READ}
    assert rights(gate, token(ed25519.Ed25519PrivateKey.generate(), "EdDSA")) is None
    path.write_bytes(b"x" * 31)
    with pytest.raises(InputError, match="32"):
        gate.reload()
    assert rights(gate, token(private, "EdDSA")) == {Right.READ}  # the earlier key stays
    path.write_bytes(b"-----BEGIN PUBLIC KEY-----\nnothing\n-----END PUBLIC KEY-----\n")
    with pytest.raises(InputError, match="Ed25519"):
        gate.reload()


BOM = b"\xef\xbb\xbf"


def test_files_of_windows_editors_are_read(tmp_path: Path) -> None:
    """They begin with a byte order mark, and their lines end with CR LF."""
    secret = "k" * 40
    (tmp_path / "key").write_bytes(BOM + secret.encode() + b"\r\n")
    entry = {"name": "a", "sha256": hash_token("open"), "rights": ["read"]}
    (tmp_path / "tokens").write_bytes(BOM + json.dumps([entry]).encode() + b"\r\n")
    (tmp_path / "revoked").write_bytes(BOM + b"gone\r\n")
    (tmp_path / "server.toml").write_bytes(
        BOM + f"tokens = '{tmp_path}/tokens'\r\njwt_key = '{tmp_path}/key'\r\n".encode()
    )
    settings = load_settings(tmp_path / "server.toml").model_copy(
        update={"revoked": tmp_path / "revoked", "link_key": tmp_path / "key"}
    )
    gate = Gate(settings)
    assert rights(gate, "open") == {Right.READ}
    assert rights(gate, token(secret, "HS256")) == {Right.READ}
    assert rights(gate, token(secret, "HS256", jti="gone")) is None
    assert read_secret(tmp_path / "key") == secret.encode()


@pytest.mark.parametrize("claim", [{"rights": {"read": 1}}, {"rights": "read"}, {"rights": ["read"], "streams": ["a"]}])
def test_a_grant_of_another_form_is_none(tmp_path: Path, claim: dict[str, Any]) -> None:
    """A list of streams would be taken for a pattern, whose brackets match single letters."""
    (tmp_path / "key").write_text("k" * 40)
    assert rights(Gate(Settings(jwt_key=tmp_path / "key")), token("k" * 40, "HS256", lod=claim)) is None
    (tmp_path / "tokens").write_text(json.dumps([{"name": "a", "sha256": hash_token("x"), **claim}]))
    with pytest.raises(InputError, match="token 0"):
        Gate(Settings(tokens=tmp_path / "tokens"))


def test_a_withdrawn_web_token_stays_withdrawn_in_every_spelling(tmp_path: Path) -> None:
    (tmp_path / "key").write_text("s" * 40)
    offered = token("s" * 40, "HS256")
    (tmp_path / "revoked").write_text(hash_token(offered))
    gate = Gate(Settings(jwt_key=tmp_path / "key", revoked=tmp_path / "revoked"))
    head, claims, signature = offered.split(".")
    assert rights(gate, token("s" * 40, "HS256", jti="other")) == {Right.READ}
    letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    last = [signature[:-1] + letter for letter in letters]  # of its bits, the lowest two mean nothing
    for spelling in (
        offered, offered + "=", offered + "==", f" {offered}", f"{offered}\n", f"{head}=.{claims}.{signature}",
        f"{head}.{claims}==.{signature}", *(f"{head}.{claims}.{each}" for each in last), f"{offered} ",
    ):  # fmt: skip
        assert rights(gate, spelling) is None, spelling


@pytest.mark.parametrize(
    "text",
    [
        b"", b"[]", b"{}", b'{"keys": 1}', b'{"keys": []}', b'{"keys": [1, null, {"kty": 1}]}', b"[" * 60_000,
        b'{"keys": [{"kty": "oct", "k": "c2hvcnQ"}]}', b'{"keys": [{"kty": "OKP", "crv": "Ed25519", "x": "AA"}]}',
        b'{"keys": ["' + b"x" * 70_000 + b'"]}', json.dumps({"keys": [{}] * 33}).encode(),
    ],
)  # fmt: skip
def test_unusable_key_sets_are_refused(text: bytes) -> None:
    with pytest.raises(InputError, match="keys"):
        parse_keys("keys", text)


@contextmanager
def publishing(answer: dict[str, Any]) -> Iterator[tuple[str, list[str]]]:
    """An HTTP server with a key set; its address and the requests that came."""
    asked: list[str] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            if "over" in answer:
                answer["over"].wait(10)
            if "raw" in answer:  # no HTTP, byte after byte
                with suppress(OSError):  # hung up on
                    for byte in answer["raw"]:
                        self.wfile.write(bytes([byte]))
                        time.sleep(answer["pause"])
                return
            body = json.dumps(answer["body"]).encode()
            self.send_response(answer.get("status", 200))
            self.send_header("Location", "/elsewhere")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/keys", asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.long
def test_a_key_set_is_fetched_kept_and_fetched_again_for_new_keys(clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = ed25519.Ed25519PrivateKey.generate(), ed25519.Ed25519PrivateKey.generate()
    answer: dict[str, Any] = {"body": {"keys": [public_key(first, "first")]}}
    with publishing(answer) as (address, asked):
        settings = Settings(jwks=address)
        with running(settings, StreamSpec(play=clip.path)) as server, server.client() as client:

            def status(offered: str) -> int:
                answer = client.get("/v1/streams/main", headers={"Authorization": f"Bearer {offered}"})
                return answer.status_code

            assert [status(token(first, "EdDSA", "first")) for _ in range(3)] == [200] * 3
            assert asked == ["/keys"]
            answer["body"]["keys"] = [public_key(second, "second")]
            assert status(token(second, "EdDSA", "second")) == 401  # asked a moment ago
            assert len(asked) == 1
            monkeypatch.setattr("streamlod.server.auth.keys._PAUSE_SECONDS", 0.0)
            monkeypatch.setattr("streamlod.server.api.access._REFUSAL_SECONDS", 0.0)
            assert status(token(second, "EdDSA", "second")) == 200
            assert status(token(first, "EdDSA", "first")) == 401
            failures: tuple[dict[str, Any], ...]
            failures = {"body": {}}, {"body": {"keys": []}}, {"body": {}, "status": 500}, {"body": {}, "status": 302}
            failures += ({"body": {"keys": ["x" * 70_000]}},)
            slow = b"HTTP/1.1 200 OK\r\n\r\n" + b" " * 1000  # a byte in time, and no end
            failures += {"raw": b"rubbish\r\n\r\n", "pause": 0}, {"raw": slow, "pause": 0.1}
            monkeypatch.setattr("streamlod.server.auth.keys._FETCH_SECONDS", 0.8)
            for broken in failures:
                answer.clear()
                answer.update(broken)
                assert status(token(first, "EdDSA", "first")) == 401
                assert status(token(second, "EdDSA", "second")) == 200  # the earlier keys stay
            assert set(asked) == {"/keys"}
    with pytest.raises(InputError, match="https"):
        Gate(Settings(jwks="http://keys.example/set"))
    Settings(host="0.0.0.0", jwks="https://keys.example/set").check()


def test_a_known_key_does_not_wait_while_others_are_fetched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamlod.server.auth.keys._PAUSE_SECONDS", 0.0)
    private = ed25519.Ed25519PrivateKey.generate()
    answer: dict[str, Any] = {"body": {"keys": [public_key(private, "known")]}}
    known, unknown = (token(private, "EdDSA", name) for name in ("known", "unknown"))

    async def run(gate: Gate, asked: list[str]) -> None:
        assert await gate.admit(known) is not None
        answer["over"] = threading.Event()
        fetching = asyncio.create_task(gate.admit(unknown))
        try:
            while len(asked) < 2:
                await asyncio.sleep(0.01)
            async with asyncio.timeout(2):
                assert await gate.admit(known) is not None
        finally:
            answer["over"].set()
            assert await fetching is None

    with publishing(answer) as (address, asked):
        asyncio.run(run(Gate(Settings(jwks=address)), asked))


def test_signed_links_open_their_path_until_they_expire(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.api.access._REFUSAL_SECONDS", 0.0)
    tokens, key = tmp_path / "tokens.json", tmp_path / "link.key"
    tokens.write_text(json.dumps([{"name": "a", "sha256": hash_token("a"), "rights": ["read"], "streams": "main"}]))
    key.write_text("s" * 32)
    settings = Settings(tokens=tokens, link_key=key)
    with running(settings, StreamSpec(play=clip.path)) as server, server.client() as client:
        reader = {"Authorization": "Bearer a"}
        limit = time.monotonic() + 60
        while client.get("/v1/streams/main", headers=reader).json()["version"] in {None, 0}:
            assert time.monotonic() < limit
            time.sleep(0.02)
        assert client.post("/v1/streams/main/links", json={}).status_code == 401
        made = client.post("/v1/streams/main/links", json={"path": "packets/1/1", "seconds": 60}, headers=reader)
        assert made.status_code == 201
        url = made.json()["url"]
        answer = client.get(url)
        assert answer.content == clip.packets[1]
        assert answer.headers["cache-control"].startswith("private")  # no shared cache may serve it to others
        assert client.head(url).status_code == 200
        query = url.partition("?")[2]
        for other in (
            f"/v1/streams/main/packets/1/0?{query}",
            f"/v1/streams/main/bitstream?{query}",
            f"/v1/streams/main?{query}",
            url.replace("signature=", "signature=0"),
            url.replace("expires=", "expires=9"),
            f"{url}&scope=/v1/streams/main/",
        ):
            assert client.get(other).status_code == 401, other
        everything = client.post("/v1/streams/main/links", json={}, headers=reader).json()
        for path in ("packets/1/0", "gops/1/0", "bitstream"):
            assert client.get(f"/v1/streams/main/{path}?{everything['query']}").status_code == 200
        assert client.get(f"/v1/streams/main/manifest?{everything['query']}").status_code == 401
        for body in ({"path": "../x"}, {"path": "manifest"}, {"seconds": 0}, {"seconds": 10**9}, {"more": 1}):
            assert client.post("/v1/streams/main/links", json=body, headers=reader).status_code == 422
    signer = LinkSigner(key)
    signer.reload()
    late = dict(pair.split("=") for pair in signer.sign("/a", int(time.time()) - 1, "1").split("&"))
    assert not signer.allows("/a", late, "1")
    assert not signer.allows("/a", {**late, "expires": "9" * 13}, "1")
    key.write_text("short")
    with pytest.raises(InputError, match="32"):
        signer.reload()


def test_a_player_that_asks_on_with_a_link_that_has_expired_shuts_nobody_out(clip: Clip, tmp_path: Path) -> None:
    tokens, key = tmp_path / "tokens.json", tmp_path / "link.key"
    tokens.write_text(json.dumps([{"name": "a", "sha256": hash_token("a"), "rights": ["read"], "streams": "main"}]))
    key.write_text("s" * 32)
    signer, path = LinkSigner(key), "/v1/streams/main/hls/index.m3u8"
    signer.reload()
    settings = Settings(tokens=tokens, link_key=key)
    with running(settings, StreamSpec(play=clip.path)) as server, server.client() as client:
        reader = {"Authorization": "Bearer a"}
        incarnation = client.get("/v1/streams/main", headers=reader).json()["incarnation"]
        for of, seconds in ((incarnation, -1), ("0" * 16, 60)):
            address = f"{path}?{signer.sign(path, int(time.time()) + seconds, of)}"
            for _ in range(settings.limits.refusals_per_minute):
                answer = client.get(address)
                assert answer.status_code == 401
                assert "the link has expired" in answer.json()["detail"]
        assert client.get("/v1/streams/main", headers=reader).status_code == 200


def test_every_refusal_takes_the_same_time(clip: Clip, tmp_path: Path) -> None:
    tokens, key = tmp_path / "tokens.json", tmp_path / "key"
    tokens.write_text(json.dumps([{"name": "a", "sha256": hash_token("a"), "rights": ["read"]}]))
    key.write_text("k" * 40)
    with running(Settings(tokens=tokens, jwt_key=key)) as server, server.client() as client:
        for offered in ("wrong", "x" * 5000, "a.b.c", token("k" * 39, "HS256"), token("k" * 40, "HS256", exp=1)):
            begin = time.monotonic()
            answer = client.get("/v1/streams", headers={"Authorization": f"Bearer {offered}"})
            assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
            assert time.monotonic() - begin >= 0.5
        assert server.registry.gate.refused == 5


def write_certificate(folder: Path, serial: int) -> tuple[Path, Path]:
    """A self-signed certificate for 127.0.0.1 and its key."""
    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name([])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), serial)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .sign(key, hashes.SHA256())
    )
    paths = folder / "certificate.pem", folder / "key.pem"
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    for path, data in zip(paths, (certificate.public_bytes(serialization.Encoding.PEM), private), strict=True):
        path.write_bytes(data)
    return paths


def serial_at(port: int) -> int:
    """Serial number of the certificate that a server shows."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with socket.create_connection(("127.0.0.1", port), 10) as plain, context.wrap_socket(plain) as secure:
        data = secure.getpeercert(binary_form=True)
    assert data is not None
    return x509.load_der_x509_certificate(data).serial_number


def write_tokens(path: Path, names: str) -> None:
    """A file of tokens that may read, one for each letter, each its own name."""
    path.write_text(json.dumps([{"name": name, "sha256": hash_token(name), "rights": ["read"]} for name in names]))


@pytest.mark.long
def test_certificates_and_tokens_are_renewed_while_viewers_stay(clip: Clip, tmp_path: Path) -> None:
    certificate, key = write_certificate(tmp_path, 1001)
    tokens, config = tmp_path / "tokens.json", tmp_path / "server.toml"
    write_tokens(tokens, "ac")
    config.write_text(f'certificate = "{certificate}"\ncertificate_key = "{key}"\ntokens = "{tokens}"\n')
    trust = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
    with serving("--play", clip.path, "--config", config) as (process, port):
        assert serial_at(port) == 1001
        address = f"wss://127.0.0.1:{port}/v1/streams/main/live"
        offers: Any = ["streamlod.v1", "bearer.a"]
        with (
            connect(address, subprotocols=offers, ssl=trust, compression=None, max_queue=None, proxy=None) as viewer,
            httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=trust, trust_env=False) as client,
        ):
            viewer.send('{"type":"hello","versions":[1]}')
            assert json.loads(viewer.recv(60))["type"] == "welcome"
            write_certificate(tmp_path, 1002)
            write_tokens(tokens, "ab")
            process.send_signal(signal.SIGHUP)
            limit = time.monotonic() + 60
            while serial_at(port) != 1002:
                assert time.monotonic() < limit
                time.sleep(0.02)
            assert client.get("/v1/streams", headers={"Authorization": "Bearer b"}).status_code == 200
            assert client.get("/v1/streams", headers={"Authorization": "Bearer c"}).status_code == 401
            before = key.read_bytes()
            write_certificate(tmp_path, 1003)
            after = key.read_bytes()
            key.write_bytes(before)  # half of the new pair is there
            process.send_signal(signal.SIGHUP)
            assert [serial_at(port) for _ in range(20)] == [1002] * 20  # the earlier pair stays
            key.write_bytes(after)
            process.send_signal(signal.SIGHUP)
            while serial_at(port) != 1003:
                assert time.monotonic() < limit + 10
                time.sleep(0.02)
            assert any(isinstance(viewer.recv(60), bytes) for _ in range(50))  # who was in stays in
