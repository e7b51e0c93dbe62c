"""The viewer page refuses what the other decoders refuse: its limits are theirs."""

from __future__ import annotations

import re
from pathlib import Path

from streamlod.codec.packet.limits import COMPLEXITY_LEVELS, MAX_NUMBERS_A_BYTE, DecoderLimits
from streamlod.server.settings import Limits

_SOURCE = (Path(__file__).parents[2] / "client" / "web" / "decode" / "packet.js").read_text(encoding="utf-8")


def numbers(text: str) -> dict[str, int]:
    """Names and values of `a: 16 << 20, b: 3`."""
    found = re.findall(r"(\w+)(?::| =) (\d+)(?: << (\d+))?", text)
    return {name: int(value) << int(shift or 0) for name, value, shift in found}


def test_the_page_takes_what_other_decoders_take() -> None:
    limits = COMPLEXITY_LEVELS["main"]
    assert limits == DecoderLimits()
    assert numbers(_SOURCE.partition("LIMITS = Object.freeze({")[2].partition("}")[0]) == {
        "packetBytes": limits.packet_bytes,
        "levels": limits.levels,
        "anchors": limits.anchors,
        "gaussians": limits.gaussians,
        "stateBytes": limits.state_bytes,
        "slots": limits.gaussians_per_anchor,
        "features": limits.features,
    }
    assert numbers(_SOURCE)["NUMBERS_A_BYTE"] == MAX_NUMBERS_A_BYTE
    assert Limits().decoder == limits
