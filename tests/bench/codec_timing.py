"""How fast the codec is, in Python and in the page's JavaScript; part of `codec_bench`."""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

import numpy as np

from streamlod.codec.coder import column_model, rans
from streamlod.codec.coder.entropy import encode_scales
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.anchors import LATENTS, Scene
from streamlod.core.scene.residual import Residual
from tests.codec.columns import decode_columns

_SYMBOLS_PER_ROW = LATENTS + 3
_ROUNDS = 3  # the first compiles


def python_speed(states: list[Scene], residuals: list[Residual]) -> None:
    """Milliseconds of computing and symbols a second, the fastest round of a few."""
    key = encode_keyframe(states[0], time_ns=0)
    symbols = _SYMBOLS_PER_ROW * sum(len(level.rows) for r in residuals for level in r.levels)
    encoding = decoding = float("inf")
    for _ in range(_ROUNDS):
        begin = time.process_time()
        packets = [encode_residual(a, r, time_ns=0) for a, r in zip(states, residuals, strict=False)]
        encoding = min(encoding, time.process_time() - begin)
        decoder = SceneDecoder()
        decoder.push(key)
        begin = time.process_time()
        for packet in packets:
            decoder.push(packet)
        decoding = min(decoding, time.process_time() - begin)
    for name, seconds in (("encoding", encoding), ("decoding", decoding)):
        print(f"Python, {name} whole packets: {1e3 * seconds / len(residuals):.2f} ms a frame,", end=" ")
        print(f"{symbols / seconds / 1e6:.1f} Msymbol/s")
    _coder_alone(residuals)


def _coder_alone(residuals: list[Residual]) -> None:
    values = np.concatenate([level.latent for r in residuals for level in r.levels]).astype(np.int64)
    _, scale = encode_scales(values)
    items, found = np.empty(200 + 8 * values.size, np.uint32), np.zeros(values.shape, np.int32)
    encoding = decoding = float("inf")
    for _ in range(_ROUNDS):
        begin = time.process_time()
        count = column_model.columns_items(values, scale, items, 0)
        words = np.empty(count + 8, np.uint16)
        first = rans.rans_encode(items, count, 4, words)
        middle = time.process_time()
        decode_columns(words[first:], 4, found, scale)
        encoding, decoding = min(encoding, middle - begin), min(decoding, time.process_time() - middle)
    print(f"Python, entropy coder alone: encoding {values.size / encoding / 1e6:.0f},", end=" ")
    print(f"decoding {values.size / decoding / 1e6:.0f} Msymbol/s")


def javascript_speed(path: Path) -> None:
    """The page's decoder under node, if there is one."""
    node = shutil.which("node")
    if node is None:
        print("JavaScript: no node here")
        return
    script = Path(__file__).with_name("codec_speed.mjs")
    print(subprocess.run([node, script, path], capture_output=True, text=True, check=True, timeout=120).stdout, end="")
