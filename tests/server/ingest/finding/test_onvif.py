"""Cameras of the network: a device that the test runs answers the probe, and strangers answer with what they like."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from streamlod.server.ingest.finding.onvif import NetworkCamera, camera_in, find_network_cameras
from tests.server.ingest.finding.probes import ANSWER, HOST, device


def test_a_device_is_found_by_its_name_among_strangers_answers() -> None:
    def answers(question: str) -> list[bytes]:
        good = ANSWER.format(question=question, name="Door%20camera")
        return [
            b"", b"\xff\xfe<", b"not xml", b"<a/>", bytes(60000),
            ANSWER.format(question="urn:uuid:of-another", name="Stranger").encode(),
            good.replace("<SOAP-ENV:Header>", "<!DOCTYPE a [<!ENTITY b 'c'>]><SOAP-ENV:Header>").encode(),
            good.encode("utf-16"),
            good.encode(),
        ]  # fmt: skip

    with device(answers) as (place, heard):
        assert find_network_cameras(place, seconds=1.0) == (NetworkCamera("127.0.0.1", "Door camera"),)
    assert "NetworkVideoTransmitter" in heard[0]
    assert "discovery/Probe<" in heard[0]


def test_without_an_answer_there_is_no_camera() -> None:
    with device(lambda _: []) as (place, _):
        assert find_network_cameras(place, seconds=0.2) == ()


def test_no_more_devices_than_allowed_are_kept() -> None:
    with device(lambda question: [ANSWER.format(question=question, name="a").encode()] * 3) as (place, _):
        assert find_network_cameras(place, seconds=0.5, most=0) == ()


@pytest.mark.parametrize(
    ("name", "shown"),
    [("Hall", "Hall"), ("a%00%1b%5b31mb", "a  [31mb"), ("%E2%80%AEevil", "evil"), ("x" * 500, "x" * 64), ("", "")],
)
def test_names_are_short_and_printable(name: str, shown: str) -> None:
    camera = camera_in(ANSWER.format(question="q", name=name).encode(), "q", HOST)
    assert camera == NetworkCamera(HOST, shown, f"http://{HOST}/onvif/device_service")


@pytest.mark.parametrize(
    ("told", "service"),
    [
        ("http://10.0.0.1/a http://[fe80::1]/b https://192.168.1.64:8443/c", "https://192.168.1.64:8443/c"),
        ("ftp://192.168.1.64/a http://192.168.1.64.example/b http://192.168.1.64@evil/c http://[/d", None),
        ("", None),
    ],
)
def test_more_is_asked_of_nobody_but_the_device_itself(told: str, service: str | None) -> None:
    answer = ANSWER.format(question="q", name="a").replace(f"http://{HOST}/onvif/device_service", told)
    assert camera_in(answer.encode(), "q", HOST) == NetworkCamera(HOST, "a", service)


def test_entities_are_never_expanded() -> None:
    """A billion laughs: refused by its declaration, before the parser sees it."""
    levels = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    bomb = ANSWER.format(question="q", name="&l9;").replace(
        '<?xml version="1.0" encoding="UTF-8"?>', f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY l0 "lol">{levels}]>'
    )
    assert camera_in(bomb.encode(), "q", HOST) is None
    assert camera_in(ANSWER.format(question="q", name="&l0;").encode(), "q", HOST) is None


@given(st.binary(max_size=300))
def test_any_bytes_are_an_answer_or_none(data: bytes) -> None:
    assert camera_in(data, "q", HOST) is None
    camera_in(ANSWER.format(question="q", name="a").encode()[:400] + data, "q", HOST)
