"""Who may push pictures: links for one camera, and what else such a link opens; questions on the socket."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from streamlod.core.close_codes import CloseCode
from streamlod.server.api.access import LINK_ENDED
from streamlod.server.auth.gate import hash_token
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL, Codec, PushMessage, pack_push
from streamlod.server.settings import Settings
from tests.server.conftest import Clip
from tests.server.ingest.push.stage import HEIGHT, WIDTH, Stage, rig, stage

ADMIN = {"Authorization": "Bearer all"}
JPEG = cv2.imencode(".jpg", np.zeros((HEIGHT, WIDTH, 3), np.uint8))[1].tobytes()


@pytest.fixture
def guarded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    """A stage whose server asks for tokens."""
    monkeypatch.setattr("streamlod.server.api.access._REFUSAL_SECONDS", 0.0)
    monkeypatch.setattr("streamlod.server.api.push.RECHECK_SECONDS", 0.05)
    file = tmp_path / "tokens.json"
    rights = {"all": ["read", "publish", "control"], "reader": ["read"]}
    file.write_text(
        json.dumps([{"name": n, "sha256": hash_token(n), "rights": r, "streams": "*"} for n, r in rights.items()])
    )
    with stage(Settings(tokens=file), rig((WIDTH, HEIGHT), 2), "all") as found:
        yield found


@contextmanager
def pushing(found: Stage, query: str = "") -> Iterator[ClientConnection]:
    address = f"ws://127.0.0.1:{found.server.port}/v1/streams/main/ingest{query}"
    with connect(address, subprotocols=[Subprotocol(PUSH_SUBPROTOCOL)], compression=None) as node:
        yield node


def ask(node: ClientConnection, question: Any) -> Any:
    node.send(json.dumps(question))
    return json.loads(node.recv(60))


def film(node: ClientConnection, camera: str, sequence: int, body: bytes = JPEG, codec: Codec = Codec.JPEG) -> Any:
    node.send(pack_push(PushMessage(camera, sequence, time.time_ns(), codec, body)))
    return json.loads(node.recv(60))


def closes(node: ClientConnection) -> int | None:
    with pytest.raises(ConnectionClosed):
        node.recv(60)
    return node.close_code


def sign(found: Stage, **body: Any) -> Any:
    with found.server.client(headers=ADMIN) as client:
        return client.post("/v1/streams/main/links", json=body)


def test_a_link_for_a_camera_opens_that_camera_until_it_expires(
    guarded: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "streamlod")
    answer = sign(guarded, path="ingest/phone1", seconds=2)
    assert answer.status_code == 201
    link = answer.json()
    assert link["url"].startswith("/capture?stream=main&camera=phone1&expires=")
    with pushing(guarded, f"?camera=phone1&{link['query']}") as node:
        assert [each["name"] for each in ask(node, {"type": "cameras"})["cameras"]] == ["phone1"]
        assert film(node, "phone1", 0)["type"] == "ack"
        refused = film(node, "phone2", 0)
        assert (refused["type"], refused["reason"]) == ("refused", "is not the one of this link, phone1")
        assert closes(node) == 4401
    with pushing(guarded, f"?camera=phone1&{link['query']}") as node:
        assert closes(node) == 4401
        assert node.close_reason == LINK_ENDED
    assert f"stream main: a phone or capture node is closed: {LINK_ENDED}" in caplog.text


def test_a_link_opens_nothing_else_and_no_other_link_opens_a_camera(guarded: Stage) -> None:
    query = sign(guarded, path="ingest/phone1").json()["query"]
    with guarded.server.client() as client:
        for path in ("", "/bitstream", "/manifest", "/links"):
            assert client.get(f"/v1/streams/main{path}?camera=phone1&{query}").status_code in {401, 405}
    everything = sign(guarded, path="").json()["query"]
    for wrong in (
        f"?camera=phone2&{query}",
        f"?camera=phone1&{query}&scope=publish",
        f"?camera=phone1&{query.replace('signature=', 'signature=0')}",
        f"?camera=phone1&{everything}",
        f"?{everything}",
        "?camera=phone1",
    ):
        with pushing(guarded, wrong) as node:
            assert closes(node) == 4401, wrong


def test_only_who_may_publish_makes_links_for_cameras(guarded: Stage, clip: Clip) -> None:
    with guarded.server.client(headers={"Authorization": "Bearer reader"}) as client:
        answer = client.post("/v1/streams/main/links", json={"path": "ingest/phone1"})
        assert answer.status_code == 403
        assert "publish" in answer.json()["detail"]
    for path in ("ingest/", "ingest/a b", "ingest/a/b", f"ingest/{'a' * 65}"):
        assert sign(guarded, path=path).status_code == 422
    with guarded.server.client(headers=ADMIN) as client:
        made = client.post("/v1/streams", json={"id": "clip", "play": str(clip.path)})
        assert made.status_code == 201
        assert client.post("/v1/streams/clip/links", json={"path": "ingest/a"}).status_code == 409


def test_capture_nodes_are_told_that_the_server_stops(caplog: pytest.LogCaptureFixture) -> None:
    with ExitStack() as nodes:
        with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found:
            node = nodes.enter_context(pushing(found))
            assert ask(node, {"type": "time", "sent": 1})["sent"] == 1
        assert closes(node) == CloseCode.STOPPING
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_connections_of_pushed_cameras_are_counted() -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 2)) as found:
        for count in (1, 2):
            with pushing(found) as node:
                for sequence in range(3):
                    assert film(node, "phone1", sequence)["type"] == "ack"
                told = found.dataset.statistics()
                assert told is not None
                assert {name: one.connections for name, one in told.cameras.items()} == {"phone1": count, "phone2": 0}


def test_questions_are_answered_and_others_close() -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 2)) as found:
        with pushing(found) as one, pushing(found) as two:
            before = time.time_ns()
            answer = ask(one, {"type": "time", "sent": 12.5})
            assert answer["sent"] == 12.5
            assert before <= answer["server_ns"] <= time.time_ns()
            assert film(one, "phone1", 0)["type"] == "ack"
            free = {"name": "phone2", "width": WIDTH, "height": HEIGHT, "taken": False, "sound": False}
            wanted = [free | {"name": "phone1", "taken": True}, free]
            assert ask(two, {"type": "cameras"}) == {"type": "cameras", "fps": 20.0, "cameras": wanted}
            one.close()
            limit = time.monotonic() + 60
            while ask(two, {"type": "cameras"})["cameras"][0]["taken"]:
                assert time.monotonic() < limit
        texts = ["", "{", "[" * 200, "7", '{"type": "time"}', '{"type": "time", "sent": NaN}']
        texts += ['{"type": "time", "sent": "1"}', '{"type": "cameras", "a": 1}', '{"type": "cameras"}' + " " * 300]
        for text in texts:
            with pushing(found) as node:
                node.send(text)
                assert closes(node) == 4400, text


def test_pictures_too_large_are_refused_before_they_are_decoded() -> None:
    """An H.264 stream of 4096x2160 pictures, and a JPEG that announces 60,000 lines."""
    encoder = av.CodecContext.create("libx264", "w")
    assert isinstance(encoder, av.VideoCodecContext)
    encoder.width, encoder.height, encoder.pix_fmt = 4096, 2160, "yuv420p"
    encoder.options = {"tune": "zerolatency", "preset": "ultrafast"}
    (packet,) = encoder.encode(av.VideoFrame.from_ndarray(np.zeros((2160, 4096, 3), np.uint8), format="rgb24"))
    large = bytearray(JPEG)
    frame = large.index(b"\xff\xc0")
    large[frame + 5 : frame + 7] = (60000).to_bytes(2, "big")
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, pushing(found) as node:
        for number, (body, codec) in enumerate([(bytes(packet), Codec.H264), (bytes(large), Codec.JPEG)]):
            assert film(node, "phone1", number, body, codec)["type"] == "refused"
        assert film(node, "phone1", 2)["type"] == "ack"
