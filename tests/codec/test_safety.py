"""Any bytes give a decoded packet or a documented refusal; never another exception, never half a state."""

from __future__ import annotations

import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.limits import DecoderLimits
from streamlod.core.errors import BitstreamError
from tests.codec.scenes import grow, make_scene, move
from tests.fuzz.corpus import SEEDS, kept, mutants
from tests.fuzz.targets import REPAIRS, TARGETS
from tests.vectors.valid import key, packet, small


def _refused(decoder: SceneDecoder, data: bytes) -> str:
    before = decoder.scene, decoder.versions
    with pytest.raises(BitstreamError) as refused:
        decoder.push(data)
    assert (decoder.scene, decoder.versions) == before
    return refused.value.code


@pytest.mark.parametrize("profile", [0, 1])
def test_truncation_at_every_byte_is_refused(profile: int) -> None:
    scene = small()
    whole = packet(scene, grow(move(scene)), profile)
    decoder = SceneDecoder()
    decoder.push(key(scene))
    for length in range(len(whole)):
        assert _refused(decoder, whole[:length]) == "truncated"


@pytest.mark.parametrize("profile", [0, 1])
def test_every_flipped_bit_is_refused(profile: int) -> None:
    scene = small()
    whole = packet(scene, move(scene, share=0.3), profile=profile)
    decoder = SceneDecoder()
    decoder.push(key(scene))
    for at in range(len(whole)):
        for bit in range(8):
            flipped = bytearray(whole)
            flipped[at] ^= 1 << bit
            _refused(decoder, bytes(flipped))
    decoder.push(whole)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(TARGETS))
def test_the_corpus_and_its_mutants_do_no_harm(name: str) -> None:
    seeds = SEEDS[name]()
    for data in [*seeds, *kept(), *mutants(seeds, 250, seed=1), b"", b"\0", b"\1" * 40, b"\4" * 41]:
        TARGETS[name](data)


@pytest.mark.parametrize("name", sorted(REPAIRS))
def test_repairing_leaves_what_is_sound_as_it_is(name: str) -> None:
    sound = [data for data in SEEDS[name]() if REPAIRS[name](data) == data]
    assert len(sound) >= len(SEEDS[name]()) // 4  # the rest are broken on purpose


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(TARGETS))
def test_many_more_mutants(name: str) -> None:
    seeds = SEEDS[name]()
    for data in mutants(seeds, 5000, seed=2):
        TARGETS[name](data)


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        (DecoderLimits(packet_bytes=500), "too_large"),
        (DecoderLimits(levels=1), "limit_exceeded"),
        (DecoderLimits(anchors=20), "limit_exceeded"),
        (DecoderLimits(features=31), "limit_exceeded"),
        (DecoderLimits(gaussians_per_anchor=3), "limit_exceeded"),
        (DecoderLimits(cameras=1), "limit_exceeded"),
    ],
)
@pytest.mark.parametrize("profile", [0, 1])
def test_limits_are_kept(limits: DecoderLimits, code: str, profile: int) -> None:
    assert _refused(SceneDecoder(limits), key(make_scene((5, 30)), profile)) == code


def test_added_anchors_count_towards_the_limit() -> None:
    scene = small()
    count = sum(map(len, scene.levels))
    decoder = SceneDecoder(DecoderLimits(anchors=count + 4))
    decoder.push(key(scene))
    first = grow(scene, added=2)
    second = grow(first, added=2)
    if sum(map(len, first.levels)) <= count + 4:
        decoder.push(packet(scene, first))
    assert _refused(decoder, packet(first, second)) == "limit_exceeded"


def test_nothing_is_taken_on_trust_before_the_checksum() -> None:
    whole = bytearray(key(small()))
    whole[30:32] = b"\xff\xff"  # a directory far beyond the packet
    with pytest.raises(BitstreamError) as refused:
        peek(bytes(whole))
    assert refused.value.code == "truncated"
