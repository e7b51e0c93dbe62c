"""The live end of one stream: the decoded state, and packets from any version to the newest, made on demand.

A viewer's session holds only the sequence number of the last packet sent; what it gets next is read from here. So a
viewer that falls behind needs no queue: one residual, made on demand, brings it up to date.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_residual
from streamlod.codec.packet.levels import select_levels, split_levels
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.residual import difference
from streamlod.server.protocol.packets import PIECE_BYTES, BinaryMessage, PacketWindow, StreamPacket
from streamlod.server.stream.broadcast import Broadcast, Receiver
from streamlod.server.stream.counters import Counters

_STATE_BYTES = 16_000_000  # of decoded states kept, from which skip packets can start
_FRAMES_SECONDS = 2.0  # after which a viewer that lags gets a residual rather than old packets one by one
_RESIDUALS = 32  # encoded on demand and kept


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """A packet, and the state that it leads to."""

    packet: StreamPacket
    scene: Scene


class Hub:
    """The live end of a stream, shared by all its viewers.

    Args:
        window_bytes: packets kept in memory.
        counters: of the stream.
        limits: of the decoder.

    Attributes:
        window: recent packets.
        broadcast: viewers that are up to date and get every new packet at once.
        listeners: called whenever something has changed; they must not raise.
    """

    def __init__(self, window_bytes: int, counters: Counters, limits: DecoderLimits = DEFAULT_LIMITS) -> None:
        self.window = PacketWindow(window_bytes)
        self._decoder = SceneDecoder(limits)
        # a thread of its own, because viewers' requests may fill the shared pool
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="hub")
        self._key: Decoded | None = None
        self._states: OrderedDict[int, Decoded] = OrderedDict()
        self._state_bytes = 0
        self._made: OrderedDict[tuple[int, int], asyncio.Task[bytes]] = OrderedDict()
        self._parts: tuple[int, list[BinaryMessage]] | None = None
        self._sent: deque[StreamPacket] = deque()
        self.broadcast = Broadcast(counters)
        self.listeners: set[Callable[[], None]] = set()

    @property
    def newest(self) -> StreamPacket | None:
        """The packet that leads to the live edge."""
        return self.window.newest

    @property
    def keyframe(self) -> StreamPacket | None:
        """The newest keyframe."""
        return None if self._key is None else self._key.packet

    @property
    def scene(self) -> Scene | None:
        """The decoded state at the live edge."""
        newest = self.newest
        return None if newest is None else self._states[newest.sequence].scene

    async def decode(self, packet: StreamPacket) -> Decoded:
        """Decode the packet after the newest one, in a thread; `send` makes it the newest.

        Raises:
            BitstreamError: it is not valid; nothing has changed.
        """
        await asyncio.get_running_loop().run_in_executor(self._thread, self._decoder.push, packet.data)
        scene = self._decoder.scene
        assert scene is not None
        return Decoded(packet, scene)

    def send(self, decoded: Decoded, message: bytes = b"") -> None:
        """Make a packet the newest one, and send it to viewers with `message`, a framed control message.

        Raises:
            ValueError: it does not follow the newest one.
        """
        packet = replace(decoded.packet, arrived=time.monotonic())
        if packet.is_key and len(packet.data) > PIECE_BYTES:
            self.broadcast.notify_all()  # each viewer gets a large keyframe at its own pace
        self.window.append(packet)
        self._sent.append(packet)
        while packet.arrived - self._sent[0].arrived > _FRAMES_SECONDS:
            self._sent.popleft().forget_messages()
        state = Decoded(packet, decoded.scene)
        if packet.is_key:
            self._key = state
        self._states[packet.sequence] = state
        self._state_bytes += _size_bytes(state)
        while len(self._states) > 2 and self._state_bytes > _STATE_BYTES:
            self._state_bytes -= _size_bytes(self._states.popitem(last=False)[1])
        self.broadcast.send(packet, message)
        self._call_listeners()

    def wake(self) -> None:
        """Wake every viewer's session."""
        self.broadcast.notify_all()
        self._call_listeners()

    def add_receiver(self, receiver: Receiver, levels: int) -> None:
        """Broadcast every packet to a viewer that is up to date, instead of calling its listener."""
        self.listeners.discard(receiver.notify)
        self.broadcast.add(receiver, levels)

    def remove_receiver(self, receiver: Receiver) -> None:
        """Undo `add_receiver`."""
        self.broadcast.remove(receiver)
        self.listeners.add(receiver.notify)

    def _call_listeners(self) -> None:
        for listener in tuple(self.listeners):
            listener()

    def can_skip_from(self, sequence: int) -> bool:
        """Whether one residual leads from packet `sequence` to the newest."""
        newest, state = self.newest, self._states.get(sequence)
        if newest is None or state is None:
            return False
        same = state.packet.position.epoch == newest.position.epoch
        return same and state.scene.keyframe == self._states[newest.sequence].scene.keyframe

    async def skip(self, sequence: int, levels: int) -> tuple[StreamPacket, BinaryMessage]:
        """The newest packet, and one residual to it from packet `sequence`; needs `can_skip_from`."""
        return await self._residual(self._states[sequence], (1 << levels) - 1)

    def key_parts(self, first: int, last: int) -> list[BinaryMessage]:
        """The newest keyframe's levels `first` to `last` as packets, coarse first.

        The part of level 0 begins the scene; the others need it.
        """
        assert self._key is not None
        packet = self._key.packet
        if self._parts is None or self._parts[0] != packet.sequence:
            self._parts = packet.sequence, [BinaryMessage(part) for part in split_levels(packet.data)]
        return self._parts[1][first : last + 1]

    async def catch_up(self, first: int, last: int) -> tuple[StreamPacket, BinaryMessage | None]:
        """The newest packet, and one residual of levels `first` to `last` to it from the newest keyframe.

        There is no residual where that packet is the keyframe itself.
        """
        assert self._key is not None
        newest = self.newest
        assert newest is not None
        if newest.sequence == self._key.packet.sequence:
            return newest, None
        mask = (1 << last + 1) - (1 << first)
        return await self._residual(self._key, mask)

    async def snapshot(self) -> list[bytes]:
        """Packets that lead to the newest state: a keyframe and, if it is older, one residual."""
        if self._key is None or self.newest is None:
            return []
        packets = [self._key.packet.data]
        if self.newest.sequence != self._key.packet.sequence:
            packets.append(await self._encoded(self._key))
        return packets

    async def _residual(self, before: Decoded, mask: int) -> tuple[StreamPacket, BinaryMessage]:
        newest = self.newest
        assert newest is not None
        packet = await self._encoded(before)
        whole = mask & newest.info.level_mask == newest.info.level_mask
        return newest, BinaryMessage(packet if whole else select_levels(packet, mask))

    async def _encoded(self, before: Decoded) -> bytes:
        """The residual from `before` to the newest state, encoded once."""
        newest = self.newest
        assert newest is not None
        key = (before.packet.sequence, newest.sequence)
        if key not in self._made:
            after = self._states[newest.sequence]
            self._made[key] = asyncio.create_task(asyncio.to_thread(_encode, before, after))
            while len(self._made) > _RESIDUALS:
                self._made.popitem(last=False)
        return await asyncio.shield(self._made[key])


def _size_bytes(state: Decoded) -> int:
    """Memory of a state that it does not share with the state before it; a keyframe shares nothing."""
    own = AnchorLevel.__slots__ if state.packet.is_key else ("position", "latent", "alive")
    return sum(getattr(level, name).nbytes for level in state.scene.levels for name in own)


def _encode(before: Decoded, after: Decoded) -> bytes:
    residual = difference(before.scene, after.scene)
    info = after.packet.info
    return encode_residual(before.scene, residual, time_ns=info.time_ns, profile=info.profile)
