"""Passwords in addresses, in every spelling that cameras have: neither shown nor stored; what is harmless stays."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from streamlod.core.masking import masked
from streamlod.server.stream.recording.sealing import Seal

SECRET = "geheim"
WITH_SECRETS = [
    "rtsp://admin:geheim@203.0.113.9/main",
    "rtsp://admin:geheim#45@203.0.113.9/main",
    "rtsp://admin:p?ss/geheim@203.0.113.9/main",
    "rtsp://admin:mein geheim@203.0.113.9/main",
    "rtsp://admin:a@geheim@203.0.113.9/main",
    "rtsp://geheim@203.0.113.9/main",
    "http://203.0.113.9/videostream.cgi?user=geheim&pwd=geheim",
    "http://203.0.113.9/videostream.cgi?loginuse=admin&loginpas=geheim",
    "http://203.0.113.9/videostream.cgi?resolution=32&USR=admin;PWD=geheim",
    "rtsp://203.0.113.9/main?auth=geheim==",
    "rtsp://203.0.113.9/main?pwd=a geheim&channel=1",
    "rtsp://203.0.113.9/main?channel=1/geheim",
    "rtsp://203.0.113.9/main?geheim",
    "rtsp://203.0.113.9/main#geheim",
    "rtsp://203.0.113.9/user=admin_password=geheim_channel=1_stream=0.sdp",
    "rtsp://203.0.113.9/user=admin&password=geheim&channel=1",
    "srt://203.0.113.9:9000?mode=caller&passphrase=geheim",
    "srt://203.0.113.9:9000?streamid=#!::u=admin,s=geheim",
    "rtsp+listen://cam:geheim@203.0.113.9:8554/x",
    "cannot open 'rtsp://a:geheim@203.0.113.9/x': http://b:geheim@203.0.113.10/y?key=geheim failed",
]
HARMLESS = [
    "rtsp://203.0.113.9/cam/realmonitor?channel=1&subtype=0",
    "http://203.0.113.9/axis-cgi/mjpg/video.cgi?resolution=640x480&fps=15",
    "srt://203.0.113.9:9000?mode=caller&latency=200000",
    "tcp://203.0.113.9:5000?listen",
    "file:///clips/a b.mp4",
    "v4l2:///dev/video0",
    "push:",
    "/clips/a=b@c.mp4",
    "source 'http://203.0.113.9:80/x?channel=1' cannot be opened (no route)",
]


@pytest.mark.parametrize("text", WITH_SECRETS)
def test_a_password_in_any_spelling_is_neither_shown_nor_stored(tmp_path: Path, text: str) -> None:
    shown = masked({"cameras": [{"source": text}]})["cameras"][0]["source"]
    assert SECRET not in shown
    assert "203.0.113.9" in shown
    assert masked(shown) == shown
    seal, definition = Seal(tmp_path / "key"), {"live": {"cameras": [{"name": "a", "source": text}]}}
    stored = seal.close(definition)
    assert SECRET not in json.dumps(stored)
    assert seal.open(stored) == definition


@pytest.mark.parametrize("text", HARMLESS)
def test_what_is_known_to_be_harmless_stays_readable(tmp_path: Path, text: str) -> None:
    assert masked(text) == text
    assert Seal(tmp_path / "key").close(text) == text
