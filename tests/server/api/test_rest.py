"""REST: what there is, what it says, downloads and their conditions, rights."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import jwt
import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.decoder import SceneDecoder
from streamlod.core.errors import InputError
from streamlod.server.auth.gate import hash_token
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings, load_settings
from tests.codec.scenes import assert_same_state
from tests.server.conftest import Clip, Running, kept_from, make_clip, running, viewing
from tests.waiting import wait


@pytest.fixture(scope="module")
def server(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    state = tmp_path_factory.mktemp("state")
    with running(Settings(state=state), StreamSpec(play=clip.path, loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        yield server


@pytest.fixture
def client(server: Running) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


def test_a_stream_tells_its_state(client: httpx.Client) -> None:
    listed = client.get("/v1/streams").json()
    assert listed["next_cursor"] is None
    assert listed["items"] == [client.get("/v1/streams/main").json()]
    stream = listed["items"][0]
    assert (stream["state"], stream["epoch"], stream["version"], stream["levels"]) == ("ended", 1, 99, 3)
    assert stream["recording"] == "on"
    assert client.get("/v1/streams", params={"cursor": "main"}).json()["items"] == []
    assert client.get("/healthz").json()["status"] == client.get("/readyz").json()["status"] == "ok"


def test_the_manifest_lists_groups_that_decode_alone(client: httpx.Client, clip: Clip, tmp_path: Path) -> None:
    manifest = client.get("/v1/streams/main/manifest").json()
    assert [(gop["first"], gop["last"], gop["packets"]) for gop in manifest["gops"]] == [(0, 59, 60), (60, 99, 40)]
    for gop in manifest["gops"]:
        answer = client.get(gop["path"])
        path = tmp_path / "gop.slod"
        path.write_bytes(answer.content)
        decoder = SceneDecoder()
        with SlodReader(path) as reader:
            for packet in reader.packets():
                decoder.push(packet)
        assert decoder.scene is not None
        assert_same_state(clip.states[gop["last"]], decoder.scene)
    begin = time.monotonic()
    later = client.get("/v1/streams/main/manifest", params={"after_epoch": 1, "after_version": 99, "wait_ms": 200})
    assert later.json()["window"]["newest"]["version"] == 99
    assert time.monotonic() - begin >= 0.2


def test_a_packet_is_what_was_published(client: httpx.Client, clip: Clip) -> None:
    for version in (0, 17, 60):
        answer = client.get(f"/v1/streams/main/packets/1/{version}")
        assert answer.content == clip.packets[version]
        assert "no-cache" in answer.headers["cache-control"]
    for path, status in (("packets/1/100", 404), ("packets/2/0", 404), ("gops/1/1", 404), ("packets/x/0", 422)):
        answer = client.get(f"/v1/streams/main/{path}")
        assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
        assert answer.json()["status"] == status


def test_the_bitstream_is_the_recorded_file(client: httpx.Client, clip: Clip, tmp_path: Path) -> None:
    path = tmp_path / "whole.slod"
    path.write_bytes(client.get("/v1/streams/main/bitstream").content)
    with SlodReader(path) as reader:
        assert list(reader.packets()) == clip.packets
        assert not reader.torn
        assert path.read_bytes() == clip.path.read_bytes()  # the index as well


def test_a_played_file_can_be_had_whole(client: httpx.Client, clip: Clip) -> None:
    """`recording` is the file itself, by ranges too; streams of other sources have none."""
    assert client.get("/v1/streams/main").json()["source"] == "recording"
    assert client.get("/v1/streams/main/recording").content == clip.path.read_bytes()
    part = client.get("/v1/streams/main/recording", headers={"Range": "bytes=-16"})
    assert (part.status_code, part.content) == (206, clip.path.read_bytes()[-16:])
    body = {"id": "made", "synthetic": {}}
    created = client.post("/v1/streams", json=body)
    assert created.status_code == 201, created.text
    assert created.json()["source"] == "data"
    assert client.get("/v1/streams/made/recording").status_code == 404
    assert client.delete("/v1/streams/made").status_code == 204


def test_downloads_answer_ranges_and_conditions(client: httpx.Client) -> None:
    path = "/v1/streams/main/bitstream"
    whole = client.get(path)
    body, etag, size = whole.content, whole.headers["etag"], len(whole.content)
    head = client.head(path)
    assert (head.status_code, head.headers["content-length"], head.content) == (200, str(size), b"")
    for text, span in (
        ("bytes=0-0", (0, 1)), ("bytes=5-", (5, size)), ("bytes=-7", (size - 7, size)), ("bytes=3-99999999", (3, size)),
        (f"bytes=30000-{size - 2}", (30000, size - 1)),
    ):  # fmt: skip
        part = client.get(path, headers={"Range": text})
        assert (part.status_code, part.content) == (206, body[slice(*span)])
        assert part.headers["content-range"] == f"bytes {span[0]}-{span[1] - 1}/{size}"
    for text in (f"bytes={size}-", "bytes=-0"):
        refused = client.get(path, headers={"Range": text})
        assert (refused.status_code, refused.headers["content-range"]) == (416, f"bytes */{size}")
    for text in ("bytes=", "bytes=-", "bytes=1-2,4-5", "items=1-2", "bytes=5-2"):
        assert client.get(path, headers={"Range": text}).status_code == 200
    assert client.get(path, headers={"If-None-Match": etag}).status_code == 304
    assert client.get(path, headers={"If-None-Match": f'"x", W/{etag}'}).status_code == 304  # as caches may weaken it
    assert client.get(path, headers={"If-None-Match": '"other"'}).status_code == 200
    assert client.get(path, headers={"Range": "bytes=0-0", "If-Range": etag}).status_code == 206
    assert client.get(path, headers={"Range": "bytes=0-0", "If-Range": '"other"'}).status_code == 200


def test_what_is_closed_may_be_kept_for_ever_and_what_grows_may_not(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path)) as server, server.client() as client:
        server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 60)
        for_good, tags = f"/v1/streams/main/incarnations/{server.stream()['incarnation']}", set()
        for path in (f"{for_good}/gops/1/0", f"{for_good}/packets/1/7"):
            answer = client.get(path)
            etag, caching = answer.headers["etag"], answer.headers["cache-control"]
            assert (etag[0], etag[-1]) == ('"', '"')  # strong
            assert caching == "public, max-age=31536000, immutable"
            assert client.get(path).headers["etag"] == etag
            kept = client.get(path, headers={"If-None-Match": f'"x", {etag}'})
            assert (kept.status_code, kept.content, kept.headers["cache-control"]) == (304, b"", caching)
            head = client.head(path)
            assert (head.status_code, head.headers["content-length"]) == (200, str(len(answer.content)))
            assert client.get(path, headers={"Range": "bytes=2-5"}).content == answer.content[2:6]
            beyond = client.get(path, headers={"Range": "bytes=99999999-"})
            assert (beyond.status_code, beyond.headers["content-type"]) == (416, "application/problem+json")
            tags.add(etag)
        growing = f"{for_good}/gops/1/60"
        for _ in range(2):
            answer = client.get(growing)
            assert answer.headers["cache-control"] in {"public, no-cache", "public, max-age=31536000, immutable"}
            tags.add(answer.headers["etag"])
            version = server.stream()["version"]
            server.wait(lambda stream, version=version: stream["version"] != version)  # type: ignore[misc]
        assert len(tags) >= 3


def test_a_blocking_manifest_answers_as_soon_as_there_is_more(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path)) as server, server.client() as client:
        server.wait(lambda stream: stream["state"] == "live")
        seen = []
        for _ in range(5):
            window = client.get("/v1/streams/main/manifest").json()["window"]["newest"]
            after = {"after_epoch": window["epoch"], "after_version": window["version"], "wait_ms": 5000}
            later = client.get("/v1/streams/main/manifest", params=after).json()["window"]["newest"]
            seen.append((window["epoch"], window["version"]) < (later["epoch"], later["version"]))
        assert all(seen)


def test_an_idle_stream_has_an_empty_manifest_and_other_methods_are_named(client: httpx.Client, clip: Clip) -> None:
    assert client.post("/v1/streams", json={"id": "idle", "play": str(clip.path)}).json()["state"] == "idle"
    manifest = client.get("/v1/streams/idle/manifest").json()
    assert (manifest["window"], manifest["gops"], manifest["epoch"]) == (None, [], None)
    assert client.get("/v1/streams/idle/bitstream").status_code == 404
    for method, path, allowed in (
        ("PUT", "/v1/streams", "GET, HEAD, POST"),
        ("GET", "/v1/streams/idle/start", "POST"),
        ("POST", "/v1/streams/idle/bitstream", "GET, HEAD"),
    ):
        refused = client.request(method, path)
        assert (refused.status_code, refused.headers["allow"]) == (405, allowed)
        assert refused.headers["content-type"] == "application/problem+json"
    assert client.post("/v1/streams", content=b"\xff", headers={"Content-Type": "application/json"}).status_code in {
        400,
        422,
    }
    assert client.delete("/v1/streams/idle").status_code == 204


def test_streams_are_created_started_stopped_and_deleted(
    client: httpx.Client, server: Running, slow_clip: Clip
) -> None:
    made = client.post("/v1/streams", json={"id": "second", "play": str(slow_clip.path), "start": True})
    assert (made.status_code, made.headers["location"]) == (201, "/v1/streams/second")
    server.wait(lambda stream: stream["state"] == "live", "second")
    assert client.post("/v1/streams", json={"id": "second", "play": str(slow_clip.path)}).status_code == 409
    assert client.post("/v1/streams/second/stop").json()["state"] == "idle"
    assert client.post("/v1/streams/second/start").status_code == 202
    server.wait(lambda stream: stream["state"] == "live" and stream["epoch"] == 2, "second")
    assert client.delete("/v1/streams/second").status_code == 204
    assert client.get("/v1/streams/second").status_code == 404
    for body in (
        {"id": "Bad", "play": "x"},
        {"id": "x"},
        {"id": "x", "play": "/none"},
        {"id": "x", "play": "n" * 4096},
        {"id": "x", "more": 1},
    ):
        assert client.post("/v1/streams", json=body).status_code == 422


def test_a_recording_without_a_keyframe_makes_no_stream(client: httpx.Client, clip: Clip, tmp_path: Path) -> None:
    with SlodReader(clip.path) as reader, SlodWriter(tmp_path / "headless.slod") as writer:
        for number in range(1, 5):
            writer.append(reader.read(number))
    refused = client.post("/v1/streams", json={"id": "headless", "play": str(tmp_path / "headless.slod")})
    assert refused.status_code == 422
    assert "no keyframe" in refused.json()["detail"]
    assert client.get("/v1/streams/headless").status_code == 404


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"set": {"keyframe.stepz": 5}}, "setting 'keyframe.stepz': unknown; did you mean keyframe.steps"),
        ({"synthetic": {"camera": 5}}, "synthetic clip: has no field 'camera'"),
        ({"synthetic": {"cameras": 2.5}}, "synthetic clip: cameras must be of type int, not 2.5"),
        ({"synthetic": {"kind": "cellar"}}, "synthetic clip: kind must be one of"),
        ({"synthetic": {"cameras": 3}, "test": ["cam07"]}, "cam07"),
        ({"synthetic": {"cameras": 3}, "train": ["cam07"]}, "cam07"),
        ({"synthetic": {"cameras": 3}, "views": 4}, "4 training cameras asked for"),
        (
            {"points": "guessed"},
            "points: there is no file 'guessed' on the server, and no method of this name: auto, colmap",
        ),
        ({"preset": "best"}, "preset"),
    ],
)
def test_what_no_worker_could_train_is_refused_at_once(
    client: httpx.Client, fields: dict[str, object], sentence: str
) -> None:
    """The stream is not made, so that nothing fails later."""
    answer = client.post("/v1/streams", json={"id": "wrong", "synthetic": {}} | fields)
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
    assert sentence in answer.text
    assert client.get("/v1/streams/wrong").status_code == 404


def test_settings_that_are_known_are_no_fault(client: httpx.Client) -> None:
    body = {"id": "other", "synthetic": {"cameras": 3}, "test": ["cam01"], "set": {"keyframe.steps": 5}}
    assert client.post("/v1/streams", json=body).status_code == 201
    wrong = client.patch("/v1/streams/other", json={"set": {"keyframe.steps": -1}})
    assert (wrong.status_code, "setting keyframe.steps: must be a whole number" in wrong.text) == (422, True)
    assert client.delete("/v1/streams/other").status_code == 204


def test_a_window_that_moved_on_is_gone_not_unknown(clip: Clip) -> None:
    settings = Settings.model_validate({"retention": {"memory_bytes": 1_000_000}})
    with running(settings, StreamSpec(play=clip.path)) as server, server.client() as client:
        server.wait(lambda stream: stream["epoch"] is not None and (stream["epoch"], stream["version"]) >= (2, 0))
        bus = server.registry.streams["main"].bus
        newest = bus.window.newest
        assert newest is not None
        bus.window = kept_from(bus.window, newest.position)
        assert client.get("/v1/streams/main/packets/1/0").status_code == 410
        assert client.get("/v1/streams/main/packets/9/0").status_code == 404


def test_a_recorded_group_whose_file_is_gone_is_left_out(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "scene.slod", 12, counts=(5, 10), key_every=4)
    settings = Settings(state=tmp_path / "state")
    with running(settings) as server, server.client() as client:
        client.post("/v1/streams", json={"id": "kept", "play": str(clip.path), "loop": False, "start": True})
        server.wait(lambda stream: stream["state"] == "ended", "kept")
    with running(settings) as server, server.client() as client:  # what was in memory is on the disk alone
        server.wait(lambda stream: stream["version"] == 11, "kept")
        (tmp_path / "state/streams/kept/000001-0000000004.slod").unlink()
        for address, status in (("packets/1/3", 200), ("packets/1/5", 404), ("gops/1/4", 404), ("bitstream", 404)):
            answer = client.get(f"/v1/streams/kept/{address}")
            assert answer.status_code == status, address
            assert str(tmp_path) not in answer.text
        with viewing(server, "kept") as viewer:
            viewer.hello(start={"epoch": 1, "version": 0})
            viewer.until_version(11)


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ({"id": "Stage"}, "id: must be 1 to 64 lower-case letters, digits, - or _, not 'Stage'"),
        ({"id": 5}, "id: must be text, not 5"),
        ({"start": "yes"}, "start: must be true or false, not 'yes'"),
        ({"loop": "no"}, "loop: must be true or false, not 'no'"),
        ({"on_demand": 1}, "on_demand: must be true or false, not 1"),
        ({"frames": "5"}, "frames: must be a whole number, not '5'"),
        ({"frames": 0}, "frames: must lie between 1 and 10000000, not 0"),
        ({"downscale": True}, "downscale: must be a number, not True"),
        ({"title": "two\nlines"}, "title: must be one line of text, not 'two\\nlines'"),
        ({"set": {"keyframe.steps": None}}, "set: keyframe.steps must be a number, text, or true or false, not None"),
        ({"frame": 5}, "frame: is not known; leave it out, or correct its name"),
        ({"points": ""}, "points: there is no file '.' on the server, and no method of this name"),
        ([], "the body: must be a table of names and values, not []"),
        (b"", "the body: is missing, and has to be given"),
        (b'{"id": "a",}', "the body is no JSON (Expecting property name enclosed in double quotes at character 11)"),
        (b"\xff", "the body is no JSON, or not in UTF-8, or nested too deeply"),
        (b"[" * 5000, "the body is no JSON, or not in UTF-8, or nested too deeply"),
    ],
)
def test_a_wrong_body_is_refused_in_one_sentence(client: httpx.Client, body: Any, sentence: str) -> None:
    if isinstance(body, dict):
        body = {"id": "wrong", "synthetic": {}} | body
    data = body if isinstance(body, bytes) else json.dumps(body)
    answer = client.post("/v1/streams", content=data, headers={"Content-Type": "application/json"})
    assert answer.status_code == (400 if sentence.startswith("the body is no JSON") else 422)
    assert answer.json()["detail"].startswith(sentence)
    assert client.get("/v1/streams/wrong").status_code == 404


@pytest.mark.parametrize("path", ["/v1/streams/", "/v1//streams", "/v1/streams/main/manifests"])
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_an_address_that_is_none_is_told(client: httpx.Client, method: str, path: str) -> None:
    answer = client.request(method, path)
    assert (answer.status_code, answer.json()["detail"]) == (404, f"there is nothing at {path}")


def test_a_stream_in_the_place_of_one_of_the_settings_can_be_changed(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path, on_demand=True)) as server, server.client() as client:
        refused = client.patch("/v1/streams/main", json={"loop": False})
        assert (refused.status_code, "of the settings" in refused.text) == (409, True)
        assert client.delete("/v1/streams/main").status_code == 204
        assert client.post("/v1/streams", json={"id": "main", "play": str(clip.path)}).status_code == 201
        assert client.patch("/v1/streams/main", json={"loop": False}).json()["loop"] is False


def test_other_wrong_fields_are_refused_in_one_sentence(client: httpx.Client, tmp_path: Path) -> None:
    for method, path, body, sentence in (
        ("GET", "?limit=500", None, "limit: must be at most 200, not '500'"),
        ("GET", "/main/packets/x/0", None, "epoch: must be a whole number, not 'x'"),
        ("DELETE", "/main?erase=perhaps", None, "erase: must be true or false, not 'perhaps'"),
        ("POST", "/main/links", {"seconds": True}, "seconds: must be a whole number, not True"),
        ("POST", "/main/links", {"path": "films"}, "path: must be bitstream, sound, hls/index.m3u8, gops/EPOCH"),
        ("PATCH", "/main", {"loop": "no"}, "loop: must be true or false, not 'no'"),
        ("POST", "", {"live": {"fps": "fast", "cameras": []}}, "rig definition: fps: must be a number, not 'fast'"),
    ):
        answer = client.request(method, f"/v1/streams{path}", json=body)
        assert (answer.status_code, answer.json()["detail"][: len(sentence)]) == (422, sentence)
    (tmp_path / "server.toml").write_text("[limits]\nviewrs = 5")
    with pytest.raises(InputError, match=r"server\.toml: limits\.viewrs: is not known; leave it out"):
        load_settings(tmp_path / "server.toml")


def test_a_body_of_another_type_is_refused(client: httpx.Client) -> None:
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        answer = client.post("/v1/streams", content=b'{"id":"x"}', headers={"Content-Type": kind})
        assert (answer.status_code, answer.headers["content-type"]) == (415, "application/problem+json"), kind
        wrong = client.get("/v1/recordings?from=never", headers={"Content-Type": kind})  # it has no body
        assert wrong.status_code == 422, kind


def test_openapi_describes_every_operation(client: httpx.Client) -> None:
    document = client.get("/openapi.json").json()
    operations = [op for path in document["paths"].values() for op in path.values()]
    assert len(operations) >= 12
    assert all(op.get("summary") and (op.get("description") or "health" in op["tags"]) for op in operations)
    for name in ("StreamBody", "NewStream", "NewLink", "Manifest"):
        assert document["components"]["schemas"][name]["examples"], name


def token_file(folder: Path, **rights: list[str]) -> Path:
    path = folder / "tokens.json"
    entries = [{"name": name, "sha256": hash_token(name), "rights": given} for name, given in rights.items()]
    path.write_text(json.dumps(entries))
    return path


def test_rights_are_kept_apart(clip: Clip, tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("k" * 40)
    tokens = token_file(tmp_path, reader=["read"], boss=["read", "control"])
    settings = Settings(tokens=tokens, jwt_key=key, limits=Limits(refusals_per_minute=3))
    with running(settings, StreamSpec(play=clip.path)) as server, server.client() as client:

        def status(method: str, path: str, token: str | None) -> int:
            headers = {"Authorization": f"Bearer {token}"} if token else {}
            return client.request(method, path, headers=headers).status_code

        claim = {"exp": time.time() + 60, "aud": "streamlod", "lod": {"rights": ["read"], "streams": "ma*"}}
        signed = jwt.encode(claim, "k" * 40, "HS256")
        other = jwt.encode({**claim, "lod": {"rights": ["read"], "streams": "x"}}, "k" * 40, "HS256")
        assert client.get("/healthz").status_code == 200
        assert status("GET", "/v1/streams/main", "reader") == status("GET", "/v1/streams/main", signed) == 200
        assert status("GET", "/v1/streams/main", other) == 403
        assert status("POST", "/v1/streams/main/stop", "reader") == 403
        assert status("POST", "/v1/streams/main/start", "boss") == 202
        wait(lambda: client.get("/v1/streams/main", headers={"Authorization": "Bearer boss"}).json()["state"] == "live")
        with viewing(server, subprotocols=["streamlod.v1", "bearer.reader"]) as viewer:
            assert viewer.connection.subprotocol == "streamlod.v1"
            viewer.hello()
        with viewing(server) as viewer, pytest.raises(ConnectionClosed) as caught:
            viewer.step()
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 4401
        expired = jwt.encode({**claim, "exp": time.time() - 60}, "k" * 40, "HS256")
        assert status("GET", "/v1/streams/main", expired) == 401
        assert status("GET", "/v1/streams/main", "wrong") == 401
        assert status("GET", "/v1/streams/main", "reader") == 429
        server.registry.gate.reload()


def test_unsafe_settings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="insecure"):
        Settings(host="0.0.0.0").check()
    Settings(host="0.0.0.0", insecure=True).check()
    Settings(host="::1").check()
    path = tmp_path / "server.toml"
    path.write_text("port = 70000")
    with pytest.raises(InputError, match="port"):
        load_settings(path)
    path.write_text("[limits]\nviewers = 5")
    assert load_settings(path).limits.viewers == 5
    for text in ("{}", '[{"sha256": "00", "rights": ["read"]}]', '[{"sha256": 1}]', "nonsense"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"server\.toml"), running(Settings(tokens=path)):
            pass
