"""The streams that network cameras offer: a device that the test runs tells them, with and without a login, or lies."""

from __future__ import annotations

import socket
from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from streamlod.core.errors import InputError
from streamlod.server.ingest.finding.onvif import NetworkCamera
from streamlod.server.ingest.finding.soap import Login, ask, envelope_in
from streamlod.server.ingest.finding.streams import find_streams, stream_addresses
from tests.server.ingest.finding.devices import Device, serving

LOGIN = Login("film", "a b/c@d:e")


def test_the_largest_picture_of_each_lens_is_found() -> None:
    with serving(Device()) as device:
        assert stream_addresses(device.camera, None) == (
            "rtsp://127.0.0.1:8554/front?channel=1&subtype=0",
            "rtsp://127.0.0.1:8554/rear",
        )


def test_a_login_is_sent_as_a_digest_by_the_cameras_clock_and_stands_in_the_addresses() -> None:
    with serving(Device(password=LOGIN.password, ahead=timedelta(hours=-7))) as device:
        front, rear = stream_addresses(device.camera, LOGIN)
    assert front == "rtsp://film:a%20b%2Fc%40d%3Ae@127.0.0.1:8554/front?channel=1&subtype=0"
    assert rear.startswith("rtsp://film:")
    assert ("GetCapabilities", False) in device.asked, "which needs none"
    assert LOGIN.password not in repr(LOGIN)


@pytest.mark.parametrize(
    ("login", "fault"),
    [(None, "wants a user and a password; give --login"), (Login("film", "wrong"), "refuses the user film")],
)
def test_a_camera_that_lets_nobody_in_says_what_to_do(login: Login | None, fault: str) -> None:
    with serving(Device(password="right")) as device, pytest.raises(InputError, match=fault):
        stream_addresses(device.camera, login)


def _body(text: str) -> bytes:
    return (
        '<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope" xmlns:tt="http://www.onvif.org/ver10/schema"'
        f' xmlns:trt="http://www.onvif.org/ver10/media/wsdl"><s:Body>{text}</s:Body></s:Envelope>'
    ).encode()


BOMB = b'<!DOCTYPE a [<!ENTITY b "cccccccccc"><!ENTITY d "&b;&b;&b;">]>' + _body("<tt:XAddr>&d;</tt:XAddr>")


@pytest.mark.parametrize(
    ("question", "body", "fault"),
    [
        ("GetCapabilities", b"not xml", "gave no answer to use"),
        ("GetCapabilities", b"\xff\xfe", "gave no answer to use"),
        ("GetCapabilities", BOMB, "gave no answer to use"),
        ("GetCapabilities", _body("<x>" * 50_000), "gave no answer to use"),
        ("GetCapabilities", _body(" " * 300_000), "gave no answer to use"),
        ("GetCapabilities", _body("<s:Fault/>"), "gave no answer to use"),
        ("GetCapabilities", _body(""), "no media service at its own address"),
        ("GetCapabilities", _body("<tt:Media><tt:XAddr>http://[/</tt:XAddr></tt:Media>"), "no media service"),
        ("GetCapabilities", _body("<tt:Media><tt:XAddr>file:///etc/passwd</tt:XAddr></tt:Media>"), "no media service"),
        ("GetProfiles", _body("<trt:Profiles token='a'/>"), "offers no stream with pictures"),
        ("GetStreamUri", _body("<tt:Uri>rtsp://10.0.0.1/a</tt:Uri>"), "not at its own address"),
        ("GetStreamUri", _body("<tt:Uri>rtsp://127.0.0.1@10.0.0.1/a</tt:Uri>"), "not at its own address"),
        ("GetStreamUri", _body("<tt:Uri>http://127.0.0.1/a</tt:Uri>"), "not at its own address"),
        ("GetStreamUri", _body("<tt:Uri>rtsp://[127.0.0.1/a</tt:Uri>"), "not at its own address"),
        ("GetStreamUri", _body("<tt:Uri>rtsp://127.0.0.1/a\x7fb</tt:Uri>"), "printable"),
        ("GetStreamUri", _body(f"<tt:Uri>rtsp://127.0.0.1/{'a' * 3000}</tt:Uri>"), "printable"),
        ("GetStreamUri", _body(""), "not at its own address"),
    ],
)
def test_what_cannot_be_used_is_refused(question: str, body: bytes, fault: str) -> None:
    with serving(Device(instead={question: body})) as device, pytest.raises(InputError, match=fault):
        stream_addresses(device.camera, None)


def test_a_camera_leads_nobody_elsewhere() -> None:
    with serving(Device(host="localhost")) as device:
        with pytest.raises(InputError, match="no media service at its own address"):
            stream_addresses(device.camera, None)
        with pytest.raises(InputError, match="names no address of its own"):
            stream_addresses(NetworkCamera("127.0.0.1", ""), None)


def test_sizes_and_clocks_that_are_none_cost_nothing_but_themselves() -> None:
    sized = "<tt:VideoEncoderConfiguration><tt:Resolution><tt:Width>{}</tt:Width><tt:Height>9</tt:Height>"
    ended = "</tt:Resolution></tt:VideoEncoderConfiguration></trt:Profiles>"
    profiles = "".join(
        f"<trt:Profiles token='{token}'>{sized.format(width)}{ended}"
        for token, width in (("sub", "9" * 5000), ("x", "-5"), ("y", "²"), ("back", "16"), ("z" * 65, "99"))
    )
    date = "<tt:UTCDateTime><tt:Date><tt:Year>99999</tt:Year><tt:Month>x</tt:Month></tt:Date></tt:UTCDateTime>"
    bodies = {"GetProfiles": _body(profiles), "GetSystemDateAndTime": _body(date)}
    with serving(Device(instead=bodies, password=LOGIN.password)) as device:
        assert stream_addresses(device.camera, LOGIN) == ("rtsp://film:a%20b%2Fc%40d%3Ae@127.0.0.1:8554/rear",)


def test_cameras_are_asked_at_the_same_time_and_the_silent_left_behind() -> None:
    with serving(Device()) as device, socket.create_server(("127.0.0.1", 0)) as silent, socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        places = [f"http://127.0.0.1:{place.getsockname()[1]}/" for place in (silent, nobody)]
        cameras = [device.camera, *(NetworkCamera("127.0.0.1", "", place) for place in places)]
        good, quiet, gone = find_streams(cameras, None, seconds=1.5)
    assert len(good.addresses) == 2
    assert good.fault == ""
    assert quiet.fault == "gave no answer in time"
    assert gone.fault == "does not answer by HTTP as cameras do"


def test_an_answer_that_is_no_http_or_leads_on_is_refused() -> None:
    with serving(Device(instead={"a": b""})) as device, pytest.raises(InputError, match="no answer to use"):
        ask(device.camera.service or "", "<a/>")
    with pytest.raises(InputError, match="does not answer by HTTP"):
        ask("http://127.0.0.1:1/a b", "<a/>")


@given(st.binary(max_size=300))
def test_any_bytes_are_xml_or_none(data: bytes) -> None:
    envelope_in(data)
