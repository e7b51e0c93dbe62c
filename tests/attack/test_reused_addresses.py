"""Addresses that caches keep for a year never lead to anything else, whatever becomes of the stream."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest

from streamlod.server.settings import Settings
from tests.server.conftest import Clip, Running, make_clip, running


def create(server: Running, client: httpx.Client, clip: Clip) -> str:
    """Create the stream and give the address of its packet 7."""
    made = client.post("/v1/streams", json={"id": "main", "play": str(clip.path), "loop": False, "start": True})
    assert made.status_code == 201, made.text
    server.wait(lambda stream: stream["state"] == "ended")
    manifest = client.get("/v1/streams/main/manifest").json()
    return f"/v1/streams/main/incarnations/{manifest['incarnation']}/packets/{manifest['epoch']}/7"


@pytest.mark.long
@pytest.mark.parametrize("recorded", [True, False])
def test_a_stream_made_anew_has_other_addresses_and_tags(tmp_path: Path, recorded: bool) -> None:
    clips = [make_clip(tmp_path / f"{number}.slod", 12, (4, 8 + number, 16), key_every=4) for number in range(2)]
    settings = Settings(state=tmp_path / "state" if recorded else None)
    with running(settings) as server, server.client() as client:
        first = create(server, client, clips[0])
        link = client.post("/v1/streams/main/links", json={}).json()
        body, tag = client.get(first).content, client.get("/v1/streams/main/bitstream").headers["etag"]
        assert "immutable" in client.get(first).headers["cache-control"]
        assert client.delete("/v1/streams/main", params={"erase": True}).status_code == 204
        second = create(server, client, clips[1])
        assert second != first
        assert client.get(second).content != body
        assert client.get(first).status_code == 410
        assert client.get("/v1/streams/main/bitstream").headers["etag"] != tag
        assert client.get(f"/v1/streams/main/bitstream?{link['query']}").status_code == 401
        assert "no-cache" in client.get("/v1/streams/main/packets/1/7").headers["cache-control"]


def test_a_stream_that_keeps_its_recording_goes_on_in_a_new_epoch(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "scene.slod", 12, (4, 8, 16), key_every=4)
    settings = Settings(state=tmp_path / "state")
    with running(settings) as server, server.client() as client:
        first = create(server, client, clip)
        assert client.delete("/v1/streams/main").status_code == 204
        assert client.get(first).status_code == 404
        second = create(server, client, clip)
        assert second == first.replace("/packets/1/", "/packets/2/")
        assert client.get(first).content == client.get(second).content == clip.packets[7]


@pytest.mark.long
def test_no_epoch_is_used_twice_though_its_recording_is_gone(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "scene.slod", 12, (4, 8, 16), key_every=4)
    settings = Settings(state=tmp_path / "state")
    with running(settings) as server, server.client() as client:
        first = create(server, client, clip)
    for path in (tmp_path / "state" / "streams" / "main").glob("*.slod"):
        path.unlink()
    with running(settings) as server, server.client() as client:
        assert client.get(first).status_code in {404, 410}
        client.post("/v1/streams/main/start")
        server.wait(lambda stream: stream["state"] == "ended" and stream["epoch"] == 2)
        assert client.get(first).status_code in {404, 410}
