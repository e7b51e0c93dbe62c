"""Sound that capture nodes push: decoded, or refused before anything large is made of it."""

from __future__ import annotations

import os
import random

import numpy as np
import pytest

from streamlod.codec.sound.encoder import SoundEncoder
from streamlod.core.errors import InputError
from streamlod.server.ingest.push.message import Codec, PushMessage
from streamlod.server.ingest.push.sound import PushedSound
from tests.clicks import clicks

NOW_NS = 1_790_000_000_000_000_000


def _message(body: bytes, codec: Codec = Codec.PCM, sequence: int = 0, capture_ns: int | None = NOW_NS) -> PushMessage:
    return PushMessage("phone1", sequence, capture_ns, codec, body)


def test_samples_and_packets_come_out_as_they_went_in() -> None:
    samples = clicks(0.5)
    (frame, time) = PushedSound("phone1").decoded(_message(samples.tobytes()), NOW_NS)[0]
    assert time == NOW_NS
    assert (frame.to_ndarray().reshape(-1, 1) == samples).all()
    sound = PushedSound("phone1")
    packets = SoundEncoder(1).put(samples, 0)
    heard = [
        frame.to_ndarray().reshape(-1)
        for number, packet in enumerate(packets)
        for frame, _ in sound.decoded(_message(packet.data, Codec.OPUS, number), NOW_NS)
    ]
    assert sum(map(len, heard)) == len(packets) * 960
    assert np.abs(np.concatenate(heard)).max() > 0.2


def test_a_repeat_is_heard_once() -> None:
    sound = PushedSound("phone1")
    assert sound.decoded(_message(bytes(200), sequence=3), NOW_NS)
    assert not sound.decoded(_message(bytes(200), sequence=3), NOW_NS)


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (_message(bytes(96_002)), "more than 96000 bytes"),
        (_message(bytes(5)), "half a sample"),
        (_message(bytes(4), capture_ns=None), "without a time"),
        (_message(bytes(4), capture_ns=NOW_NS + 6_000_000_000), "6 s too early"),
        (_message(b"\xff" * 40, Codec.OPUS), "does not decode"),
        (_message(b"\xfb", Codec.OPUS), "does not decode"),
    ],
)
def test_what_is_no_sound_is_refused(message: PushMessage, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        PushedSound("phone1").decoded(message, NOW_NS)


def test_noise_makes_no_more_than_a_packets_length_of_sound() -> None:
    sound, noise = PushedSound("phone1"), random.Random(int(os.environ.get("STREAMLOD_SEED", "1")))
    for number in range(2000):
        body = noise.randbytes(noise.randint(1, 300))
        try:
            frames = sound.decoded(_message(body, Codec.OPUS, number), NOW_NS)
        except InputError:
            continue
        assert sum(frame.samples for frame, _ in frames) <= 5760
