"""Cameras of the network: a device that the test runs answers the probe, and strangers answer with what they like."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from streamlod.server.ingest.finding.onvif import NetworkCamera, find_network_cameras, name_in

ANSWER = """<?xml version="1.0" encoding="UTF-8"?>
<SOAP-ENV:Envelope xmlns:SOAP-ENV="http://www.w3.org/2003/05/soap-envelope"
 xmlns:wsa="http://schemas.xmlsoap.org/ws/2004/08/addressing"
 xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery"><SOAP-ENV:Header>
<wsa:RelatesTo>{question}</wsa:RelatesTo>
<wsa:Action>http://schemas.xmlsoap.org/ws/2005/04/discovery/ProbeMatches</wsa:Action></SOAP-ENV:Header>
<SOAP-ENV:Body><d:ProbeMatches><d:ProbeMatch>
<d:Scopes>onvif://www.onvif.org/type/video_encoder onvif://www.onvif.org/name/{name}</d:Scopes>
<d:XAddrs>http://192.168.1.64/onvif/device_service</d:XAddrs></d:ProbeMatch></d:ProbeMatches></SOAP-ENV:Body>
</SOAP-ENV:Envelope>"""


@contextmanager
def device(answers: Callable[[str], list[bytes]]) -> Iterator[tuple[tuple[str, int], list[str]]]:
    """A device on loopback: its place, and the probes that came."""
    heard: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        place.settimeout(20)

        def serve() -> None:
            probe, asker = place.recvfrom(65536)
            heard.append(probe.decode())
            found = re.search(r"MessageID>(.+?)<", heard[0])
            assert found is not None
            for answer in answers(found[1]):
                place.sendto(answer, asker)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield place.getsockname(), heard
        thread.join(60)
        assert not thread.is_alive()


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
    assert name_in(ANSWER.format(question="q", name=name).encode(), "q") == shown


def test_entities_are_never_expanded() -> None:
    """A billion laughs: refused by its declaration, before the parser sees it."""
    levels = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    bomb = ANSWER.format(question="q", name="&l9;").replace(
        '<?xml version="1.0" encoding="UTF-8"?>', f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY l0 "lol">{levels}]>'
    )
    assert name_in(bomb.encode(), "q") is None
    assert name_in(ANSWER.format(question="q", name="&l0;").encode(), "q") is None


@given(st.binary(max_size=300))
def test_any_bytes_are_an_answer_or_none(data: bytes) -> None:
    assert name_in(data, "q") is None
    name_in(ANSWER.format(question="q", name="a").encode()[:400] + data, "q")
