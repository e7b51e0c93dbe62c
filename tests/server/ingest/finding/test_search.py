"""Looking for cameras: a device that answers the probe is asked for its streams, which get names for a rig."""

from __future__ import annotations

from contextlib import ExitStack

from streamlod.server.ingest.finding.search import search
from streamlod.server.ingest.finding.soap import Login
from tests.server.ingest.finding.devices import Device, serving
from tests.server.ingest.finding.probes import ANSWER, HOST, device


def _found(fake: Device, called: str, login: Login | None) -> tuple[dict[str, str], list[str]]:
    """Sources by name, and what was said."""
    said: list[str] = []
    with ExitStack() as stack:
        stack.enter_context(serving(fake))

        def answers(question: str) -> list[bytes]:
            place = f"127.0.0.1:{fake.port}"
            return [ANSWER.format(question=question, name=called).replace(HOST, place).encode()]

        place, _ = stack.enter_context(device(answers))
        found = search(said.append, login, place, 0.5)
    return {each.name: each.source for each in found if not each.name.startswith("webcam")}, said


def test_network_cameras_are_named_and_can_be_opened() -> None:
    sources, said = _found(Device(password="x"), "Hall%20%2F%20door", Login("film", "x"))
    assert sources == {
        "Hall-door": "rtsp://film:x@127.0.0.1:8554/front?channel=1&subtype=0",
        "Hall-door-2": "rtsp://film:x@127.0.0.1:8554/rear",
    }
    assert "Hall-door-2: Hall / door at 127.0.0.1 (ONVIF)" in said


def test_a_camera_without_a_usable_name_gets_one() -> None:
    assert list(_found(Device(), "%E9%97%A8", None)[0]) == ["network", "network-2"]


def test_a_camera_that_tells_nothing_is_named_with_what_to_do() -> None:
    sources, said = _found(Device(password="x"), "Hall", None)
    assert not sources
    assert "Hall at 127.0.0.1 (ONVIF) wants a user and a password; give --login USER:PASSWORD" in said
    assert said[-1].startswith("give addresses that are not found yourself: rtsp://")
