"""Packets that unpack to more memory than the settings allow."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from streamlod.client.playback import Playback
from streamlod.codec.encoder import encode_keyframe
from streamlod.codec.packet.limits import DecoderLimits
from streamlod.core.errors import BitstreamError, SessionError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.client.test_playback import WELCOME
from tests.codec.scenes import make_scene
from tests.server.conftest import make_clip, running


def test_a_stream_of_larger_scenes_than_allowed_reaches_nobody_and_fails(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "large.slod", 3, (100, 1000, 9000))
    settings = Settings.model_validate(
        {"limits": {"anchors": 1000}, "worker": {"attempts": 1, "first_delay_seconds": 0.01}}
    )
    with running(settings, StreamSpec(play=clip.path)) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
        assert found["version"] is None
        assert "limit_exceeded" in found["detail"]


def test_a_client_refuses_larger_scenes_than_it_wants() -> None:
    packet = encode_keyframe(make_scene((100, 1000, 9000)), time_ns=0, profile=0)
    roomy, tight = (Playback(limits) for limits in (DecoderLimits(), DecoderLimits(anchors=1000)))
    for playback in (roomy, tight):
        playback.receive_text(json.dumps(WELCOME))
    roomy.receive_packet(packet, 0.0)
    with pytest.raises((BitstreamError, SessionError)):
        tight.receive_packet(packet, 0.0)


def test_the_settings_reach_the_decoder() -> None:
    decoder = Limits(packet_bytes=5000, anchors=7, state_bytes=2**21).decoder
    assert (decoder.packet_bytes, decoder.anchors, decoder.state_bytes) == (5000, 7, 2**21)
