"""The sound of a played recording, over REST and to whom."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import write_sound
from streamlod.server.auth.gate import hash_token
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.clicks import clicks
from tests.server.conftest import Clip, Running, make_clip, running, viewing

PATH = "/v1/streams/main/sound"


@pytest.fixture(scope="module")
def sounding(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """A clip with two seconds of sound that begin at 40 ms."""
    clip = make_clip(tmp_path_factory.mktemp("sounding") / "clip.slod", 20)
    write_sound(sound_beside(clip.path), [clicks(2.0, channels=2)], 2, 40_000_000)
    return clip


@pytest.fixture(scope="module")
def server(sounding: Clip, clip: Clip) -> Iterator[Running]:
    with running(Settings(), StreamSpec(play=sounding.path), StreamSpec(id="silent", play=clip.path)) as server:
        yield server


def test_sound_is_told_of_and_served_by_ranges(server: Running, sounding: Clip) -> None:
    data = sound_beside(sounding.path).read_bytes()
    assert server.stream()["sound"] == {"begin_ns": 40_000_000, "channels": 2, "live": False, "camera": None}
    with viewing(server) as viewer:
        assert viewer.hello().welcome["sound"] == {"begin_ns": 40_000_000, "channels": 2, "live": False, "camera": None}
    with server.client() as client:
        whole = client.get(PATH)
        assert (whole.content, whole.headers["content-type"]) == (data, "audio/ogg")
        part = client.get(PATH, headers={"Range": "bytes=100-299"})
        assert (part.status_code, part.content) == (206, data[100:300])
        assert client.get(PATH, headers={"If-None-Match": whole.headers["etag"]}).status_code == 304
        assert client.get(PATH, headers={"Range": f"bytes={len(data)}-"}).status_code == 416


def test_a_stream_without_sound_says_so(server: Running) -> None:
    assert server.stream("silent")["sound"] is None
    with server.client() as client:
        assert client.get("/v1/streams/silent/sound").status_code == 404
        assert client.get("/v1/streams/nobody/sound").status_code == 404
        for name in ("..%2fmain", "main%2f..%2fsilent", "silent%00", "%2e%2e"):
            assert client.get(f"/v1/streams/{name}/sound").status_code in (404, 422)


def test_only_who_may_read_the_stream_hears_it(sounding: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamlod.server.api.access._REFUSAL_SECONDS", 0.0)
    grants = {"viewer": ["read"], "operator": ["control"], "stranger": ["read"]}
    streams = {"stranger": "other-*"}
    entries = [
        {"name": name, "sha256": hash_token(name), "rights": rights, "streams": streams.get(name, "main")}
        for name, rights in grants.items()
    ]
    (tmp_path / "tokens.json").write_text(json.dumps(entries))
    with running(Settings(tokens=tmp_path / "tokens.json"), StreamSpec(play=sounding.path)) as server:
        got = {}
        with server.client() as client:
            for name in ("viewer", "operator", "stranger", "nobody"):
                got[name] = client.get(PATH, headers={"Authorization": f"Bearer {name}"}).status_code
            assert got == {"viewer": 200, "operator": 403, "stranger": 403, "nobody": 401}
            assert client.get(PATH).status_code == 401
            asked = {"json": {"path": "sound", "seconds": 60}, "headers": {"Authorization": "Bearer viewer"}}
            link = client.post("/v1/streams/main/links", **asked).json()["url"]  # type: ignore[arg-type]
            signed = client.get(link)  # an element of a page can say no token
            assert signed.content == sound_beside(sounding.path).read_bytes()
            assert "private" in signed.headers["cache-control"]
            assert client.get(link.replace("/sound", "/recording")).status_code == 401


def test_what_lies_beside_a_recording_but_is_no_sound_of_it_is_not_served(clip: Clip, tmp_path: Path) -> None:
    """A link to elsewhere, a text, a folder; and what lies beside a link is not beside the recording itself."""
    secret = tmp_path / "secret.key"
    secret.write_text("s" * 100)
    write_sound(tmp_path / "elsewhere.opus", [clicks(0.5)], 1, 0)
    streams = []
    for name in ("link", "text", "folder"):
        path = tmp_path / f"{name}.slod"
        path.write_bytes(clip.path.read_bytes())
        streams.append(StreamSpec(id=name, play=path))
    sound_beside(tmp_path / "link.slod").symlink_to(tmp_path / "elsewhere.opus")
    sound_beside(tmp_path / "text.slod").write_text("s" * 100)
    sound_beside(tmp_path / "folder.slod").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "alias.slod").symlink_to(clip.path)
    write_sound(sound_beside(tmp_path / "outside" / "alias.slod"), [clicks(0.5)], 1, 0)
    streams.append(StreamSpec(id="alias", play=tmp_path / "outside" / "alias.slod"))
    with running(Settings(), *streams) as server, server.client() as client:
        for stream in streams:
            assert server.stream(stream.id)["sound"] is None
            assert client.get(f"/v1/streams/{stream.id}/sound").status_code == 404
