"""The live end of one stream: the decoded state, and packets from any version to the newest, made on demand.

Viewers hold nothing but a number; what they get next is read from here. So a viewer that falls behind costs no memory,
and is brought up to date by one residual of exact integers instead of a queue.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from codec.decoder import SceneDecoder
from codec.encoder import encode_residual
from codec.packet.levels import select_levels, split_levels
from codec.packet.limits import DEFAULT_LIMITS, Limits
from codec.packet.packet import PacketKind
from core.scene.anchors import AnchorLevel, Scene
from core.scene.residual import difference
from server.protocol.packets import PIECE_BYTES, PacketWindow, StreamPacket, binary_frame
from server.stream.broadcast import Lane, Lanes
from server.stream.counters import Counters

_STATE_BYTES = 16_000_000  # decoded states kept, to begin skip packets from
_FRAMES_SECONDS = 2.0  # after which a viewer that lags gets a residual rather than old packets one by one
_RESIDUALS = 32  # encoded on demand and kept


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    packet: StreamPacket
    scene: Scene


class Hub:
    """What all viewers of a stream share.

    Args:
        window_bytes: packets kept in memory.
        counters: of the stream.
        limits: of the decoder.

    Attributes:
        window: recent packets.
        lanes: viewers that are given every new packet at once.
        listeners: called whenever something has changed; they must not raise.
    """

    def __init__(self, window_bytes: int, counters: Counters, limits: Limits = DEFAULT_LIMITS) -> None:
        self.window = PacketWindow(window_bytes)
        self._decoder = SceneDecoder(limits)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="hub")  # what viewers ask for may fill the shared pool
        self._key: _State | None = None
        self._states: OrderedDict[int, _State] = OrderedDict()
        self._state_bytes = 0
        self._made: OrderedDict[tuple[int, int], asyncio.Task[bytes]] = OrderedDict()
        self._parts: tuple[int, list[bytes]] | None = None
        self._framed: deque[StreamPacket] = deque()
        self.lanes = Lanes(counters)
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
        return None if newest is None else self._states[newest.number].scene

    async def accept(
        self, packet: StreamPacket, message: bytes = b"", on_decoded: Callable[[], None] = lambda: None
    ) -> None:
        """Decode the newest packet, in a thread, and offer it to viewers; a framed control message goes with it.

        Args:
            on_decoded: called when the packet is known to be valid, just before it is the newest.

        Raises:
            BitstreamError: it is not valid; nothing has changed.
            ValueError: it does not follow the newest one.
        """
        await asyncio.get_running_loop().run_in_executor(self._thread, self._decoder.push, packet.data)
        scene = self._decoder.scene
        assert scene is not None
        on_decoded()
        packet = replace(packet, arrived=time.monotonic())
        if packet.is_key and len(packet.data) > PIECE_BYTES:
            self.lanes.rouse()  # each viewer gets a large keyframe at its own pace
        self.window.append(packet)
        self._framed.append(packet)
        while packet.arrived - self._framed[0].arrived > _FRAMES_SECONDS:
            self._framed.popleft().forget_frames()
        state = _State(packet, scene)
        if packet.is_key:
            self._key = state
        self._states[packet.number] = state
        self._state_bytes += _size_bytes(state)
        while len(self._states) > 2 and self._state_bytes > _STATE_BYTES:
            self._state_bytes -= _size_bytes(self._states.popitem(last=False)[1])
        self.lanes.pass_on(packet, message)
        self._call_listeners()

    def wake(self) -> None:
        """Let every viewer look again."""
        self.lanes.rouse()
        self._call_listeners()

    def enter_lane(self, lane: Lane, levels: int) -> None:
        """Give a viewer that is up to date every packet from now on, and call its listener no more."""
        self.listeners.discard(lane.rouse)
        self.lanes.enter(lane, levels)

    def leave_lane(self, lane: Lane) -> None:
        """Undo `enter_lane`."""
        self.lanes.leave(lane)
        self.listeners.add(lane.rouse)

    def _call_listeners(self) -> None:
        for listener in tuple(self.listeners):
            listener()

    def can_skip(self, number: int) -> bool:
        """Whether one residual leads from packet `number` to the newest."""
        newest, state = self.newest, self._states.get(number)
        if newest is None or state is None:
            return False
        same = state.packet.position.epoch == newest.position.epoch
        return same and state.scene.keyframe == self._states[newest.number].scene.keyframe

    async def skip(self, number: int, levels: int) -> tuple[StreamPacket, bytes]:
        """The newest packet, and one framed residual to it from packet `number`; needs `can_skip`."""
        return await self._residual(self._states[number], (1 << levels) - 1)

    def key_parts(self, first: int, last: int) -> list[bytes]:
        """The newest keyframe's levels `first` to `last` as framed packets, coarse first.

        The part of level 0 begins the scene; the others need it.
        """
        assert self._key is not None
        packet = self._key.packet
        if self._parts is None or self._parts[0] != packet.number:
            self._parts = packet.number, [binary_frame(part) for part in split_levels(packet.data)]
        return self._parts[1][first : last + 1]

    async def catch_up(self, first: int, last: int) -> tuple[StreamPacket, bytes | None]:
        """The newest packet, and one framed residual of levels `first` to `last` to it from the newest keyframe.

        There is no residual where that packet is the keyframe itself.
        """
        assert self._key is not None
        newest = self.newest
        assert newest is not None
        if newest.number == self._key.packet.number:
            return newest, None
        mask = (1 << last + 1) - (1 << first)
        return await self._residual(self._key, mask)

    async def snapshot(self) -> list[bytes]:
        """Packets that lead to the newest state: a keyframe and, if it is older, one residual."""
        if self._key is None or self.newest is None:
            return []
        packets = [self._key.packet.data]
        if self.newest.number != self._key.packet.number:
            packets.append(await self._encoded(self._key))
        return packets

    async def _residual(self, before: _State, mask: int) -> tuple[StreamPacket, bytes]:
        newest = self.newest
        assert newest is not None
        packet = await self._encoded(before)
        whole = mask & newest.info.level_mask == newest.info.level_mask
        return newest, binary_frame(packet if whole else select_levels(packet, mask))

    async def _encoded(self, before: _State) -> bytes:
        """The residual from `before` to the newest state, encoded once."""
        newest = self.newest
        assert newest is not None
        key = (before.packet.number, newest.number)
        if key not in self._made:
            after = self._states[newest.number]
            self._made[key] = asyncio.create_task(asyncio.to_thread(_encode, before, after))
            while len(self._made) > _RESIDUALS:
                self._made.popitem(last=False)
        return await asyncio.shield(self._made[key])


def _size_bytes(state: _State) -> int:
    """Memory that a state takes beside the one before it: a keyframe's columns are all its own."""
    own = AnchorLevel.__slots__ if state.packet.is_key else ("position", "latent", "alive")
    return sum(getattr(level, name).nbytes for level in state.scene.levels for name in own)


def _encode(before: _State, after: _State) -> bytes:
    residual = difference(before.scene, after.scene)
    kind = PacketKind.CATCH_UP if before.scene.version == before.scene.keyframe else PacketKind.SKIP
    info = after.packet.info
    return encode_residual(before.scene, residual, kind=kind, time_ns=info.time_ns, profile=info.profile)
