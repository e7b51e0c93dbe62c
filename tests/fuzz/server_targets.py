"""What strangers send to the server: each target takes any bytes and lets nothing out but the documented errors.

`python -m tests.fuzz.run_server TARGET [libFuzzer options]` fuzzes with atheris; ordinary tests replay the seeds.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import jwt
from pydantic import ValidationError

from streamlod.core.errors import InputError, SessionError
from streamlod.server.api.ranges import _parse_range
from streamlod.server.api.schemas import NewLink
from streamlod.server.auth.gate import Gate, hash_token, read_tokens
from streamlod.server.auth.keys import parse_keys
from streamlod.server.auth.links import LinkSigner
from streamlod.server.http.problems import Problem
from streamlod.server.pipeline.new_stream import NewStream
from streamlod.server.protocol.messages import parse_control, parse_hello
from streamlod.server.settings import Settings, load_settings

_SECRET = "fuzz" * 10


def hello(data: bytes) -> None:
    """A viewer's first message."""
    with suppress(SessionError):
        found = parse_hello(data.decode(errors="replace"))
        assert found.levels is None or 1 <= found.levels <= 64
        assert len(found.client) <= 200


def control(data: bytes) -> None:
    """A viewer's later message."""
    with suppress(SessionError):
        parse_control(data.decode(errors="replace"))


def token(data: bytes) -> None:
    """A bearer token: none but those that were signed or listed open anything."""
    offered = data.decode("latin-1")
    grant = _gate().grant_of(offered)
    assert grant is None or offered in _valid_tokens(), "a token was forged"


def keys(data: bytes) -> None:
    """A key set, and a token file."""
    with suppress(InputError):
        parse_keys("keys", data)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tokens.json"
        path.write_bytes(data)
        with suppress(InputError):
            read_tokens(path)


def definition(data: bytes) -> None:
    """The bodies of requests, and a configuration file."""
    with suppress(ValidationError, InputError):
        _ = NewStream.model_validate_json(data).spec
    with suppress(ValidationError):
        NewLink.model_validate_json(data)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "server.toml"
        path.write_bytes(data)
        with suppress(InputError):
            load_settings(path)


def address(data: bytes) -> None:
    """A Range header, and the query of a signed link."""
    text = data.decode("latin-1")
    with suppress(Problem):
        found = _parse_range(text, 1000)
        assert found is None or 0 <= found[0] < found[1] <= 1000
    fields = dict(part.partition("=")[::2] for part in text.split("&"))
    assert not _signer().allows("/v1/streams/main/bitstream", fields, "1"), "a link was forged"


@cache
def _gate() -> Gate:
    folder = Path(tempfile.mkdtemp())
    (folder / "tokens.json").write_text(json.dumps([{"name": "a", "sha256": hash_token("known"), "rights": ["read"]}]))
    (folder / "key").write_text(_SECRET)
    return Gate(Settings(tokens=folder / "tokens.json", jwt_key=folder / "key"))


@cache
def _signer() -> LinkSigner:
    return LinkSigner(None)


@cache
def _valid_tokens() -> tuple[str, ...]:
    claims = {"exp": 2**33, "aud": "streamlod", "lod": {"rights": ["read"], "streams": "ma*"}}
    return "known", jwt.encode(claims, _SECRET, "HS256"), jwt.encode({**claims, "lod": 1}, _SECRET, "HS256")


TARGETS: dict[str, Callable[[bytes], None]] = {
    "hello": hello,
    "control": control,
    "token": token,
    "keys": keys,
    "definition": definition,
    "address": address,
}
SEEDS: dict[str, tuple[bytes, ...]] = {
    "hello": (
        b'{"type":"hello","versions":[1],"client":"NAME/1.0","start":"live"}',
        b'{"type":"hello","versions":[1,2],"start":{"epoch":1,"version":3},"levels":2,"kilobytes_per_second":5e2}',
        b'{"type":"hello","versions":[1],"pictures":true}',
        b'{"type":"hello","versions":[true],"levels":NaN}',
        b"[" * 3000,
    ),
    "control": (
        b'{"type":"ack","bytes":1234567,"epoch":1,"version":57,"decode_ms":4.2}',
        b'{"type":"set","levels":3,"kilobytes_per_second":null}',
        b'{"type":"seek","to":{"epoch":1,"version":40}}',
        b'{"type":"seek","to":"live","stop":true}',
        b'{"type":"pause"}',
        b'{"type":"ack","picture":3}',
        b'{"type":"view","width":640,"height":360,"focal":[500,500],"rotation":[1,0,0,0],"position":[0,0,0]}',
        b'{"type":"pick","id":1,"origin":[0,0,0],"direction":[0,0,1]}',
        b'{"type":"ack","bytes":1e999}',
    ),
    "token": tuple(text.encode() for text in (*_valid_tokens(), "", "a.b.c", "..", "eyJhbGciOiJub25lIn0.e30.")),
    "keys": (
        b'{"keys":[{"kty":"OKP","crv":"Ed25519","x":"11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo","kid":"a"}]}',
        b'{"keys":[{"kty":"oct","k":"' + b"A" * 60 + b'","alg":"HS256"},{"kty":"RSA","n":"AQAB","e":"AQAB"}]}',
        b'[{"name":"a","sha256":"' + b"0" * 64 + b'","rights":["read","control"],"streams":"ma*"}]',
        b'{"keys":[{"kty":"EC","crv":"P-256","x":"AA","y":"AA","kid":1}]}',
    ),
    "definition": (
        b'{"id":"stage","synthetic":{"cameras":5,"frames":30},"start":true}',
        b'{"id":"stage","play":"/data/scene.slod","loop":false}',
        b'{"id":"stage","live":{"cameras":[{"name":"cam00","source":"rtsp://127.0.0.1/a"}],"fps":30}}',
        b'{"path":"gops/1/0","seconds":60}',
        b'port = 8000\norigins = ["https://a.example"]\n[limits]\nviewers = 5\n[[streams]]\nid = "main"\nplay = "a"\n',
    ),
    "address": (b"bytes=0-499", b"bytes=-5", b"bytes=5-", b"expires=99999999999&signature=00", b"scope=/v1/&expires=1"),
}
