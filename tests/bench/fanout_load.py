"""What the fan-out bench sends: real packets of a small scene, filled up with an extension chunk to the size wanted.

A decoder skips the extension, so the bench measures the way of bytes to viewers and not the decoder.
"""

from __future__ import annotations

import os
import socket
import struct
from dataclasses import dataclass, replace

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.packet import FIRST_EXTENSION, make_chunk
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from tests.codec.scenes import make_scene, move

_STEP_NS = 100_000_000
_KEY_EVERY = 10
_SO_MEMINFO = 55


@dataclass(frozen=True, slots=True)
class Run:
    """One stretch of publishing, as its server saw it.

    Attributes:
        published_ns: monotonic time by version.
        cpu_seconds: of the server's process, without what looking for the end of writing took.
        wall_seconds: how long it took.
        sent_bytes: given to all viewers' sockets.
        resident_bytes: of the server's process, afterwards.
        kernel_bytes: in the socket buffers of the server, afterwards.
        cut_off: viewers closed so far for taking nothing.
        faults: reasons of viewers closed so far, as logged.
    """

    published_ns: dict[int, int]
    cpu_seconds: float
    wall_seconds: float
    sent_bytes: int
    resident_bytes: int
    kernel_bytes: int
    cut_off: int
    faults: tuple[str, ...]


def make_packets(count: int, size_bytes: int) -> list[bytes]:
    """`count` packets of about `size_bytes`, a (small) keyframe every 10."""
    filling = make_chunk(0, FIRST_EXTENSION, os.urandom(size_bytes))
    first = make_scene((5, 20, 40))
    scene, packets = first, []
    for version in range(count):
        if version % _KEY_EVERY == 0:
            scene = Scene(first.header, first.weights, first.levels, version, version)
            packets.append(encode_keyframe(scene, time_ns=version * _STEP_NS, profile=0))
            continue
        before, scene = scene, move(scene)
        residual = difference(before, scene)
        data = encode_residual(before, residual, time_ns=version * _STEP_NS, profile=0)
        packets.append(_filled(data, filling))
    return packets


def _filled(data: bytes, filling: object) -> bytes:
    packet = parse(data)
    at = next((n for n, chunk in enumerate(packet.chunks) if chunk.level > 0), len(packet.chunks))
    return build(replace(packet, chunks=(*packet.chunks[:at], filling, *packet.chunks[at:])))  # type: ignore[arg-type]


def resident_bytes() -> int:
    """Resident memory of this process."""
    with open("/proc/self/statm") as file:  # noqa: PTH123
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


def kernel_bytes(peer: socket.socket) -> int:
    """Memory of the kernel for one socket's data, at this end (SO_MEMINFO of linux/sock_diag.h)."""
    words = struct.unpack("9I", peer.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 36))
    received, _, _, _, reserved, queued, *_ = words
    return int(received + reserved + queued)
