"""One training step of a later frame: all its views in one pass, from integers to integers, without the host.

The kernels are launched once while a graph is recorded and replayed afterwards: on CUDA a CUDA graph, on the CPU Warp's
own recording. What differs from step to step lies in two small arrays, `told` and `chosen`, which are written between.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp

from streamlod.core.render.warp.kernels.lanes import LANES
from streamlod.core.render.warp.listing import list_gaussians
from streamlod.core.render.warp.pictures import differentiate, draw
from streamlod.core.train.engine.warp.kernels.adam import adam
from streamlod.core.train.engine.warp.kernels.added import adam_added, decode_added, differentiate_added
from streamlod.core.train.engine.warp.kernels.decode import decode, differentiate_decode
from streamlod.core.train.engine.warp.kernels.layout import TOLD
from streamlod.core.train.engine.warp.kernels.loss import blur_moments, blur_slopes, compare, differentiate_loss
from streamlod.core.train.engine.warp.kernels.rate import gather
from streamlod.core.train.engine.warp.room import StepRoom


class TrainingStep:
    """Launches or replays steps in the memory of `room`."""

    def __init__(self, room: StepRoom) -> None:
        self.room = room
        self._graph: Any = None
        c = room.capacity
        pinned = room.device != "cpu"
        self._told = wp.zeros((c.steps, TOLD), dtype=float, device="cpu", pinned=pinned)
        self._chosen = wp.zeros((c.steps, c.views), dtype=int, device="cpu", pinned=pinned)

    def run(self, number: int, told: Sequence[float], cameras: Sequence[int]) -> None:
        """Take step `number` of the frame with what it is `told` (`kernels.layout`), on the pictures of `cameras` [V].

        The first step ever is launched kernel by kernel, which loads them all, and then recorded.

        Raises:
            ValueError: there is no room for so many steps, or `cameras` are not as many as the views.
        """
        capacity = self.room.capacity
        if not 0 <= number < capacity.steps or len(cameras) != capacity.views:
            raise ValueError(f"step {number} of {capacity.steps} with {len(cameras)} of {capacity.views} views")
        self.tell(number, told, cameras)
        if self._graph is None:
            self.launch()
            self._graph = self.recorded()
        else:
            wp.capture_launch(self._graph)

    def tell(self, number: int, told: Sequence[float], cameras: Sequence[int]) -> None:
        """Write what differs from step to step; no row of host memory is used twice in a frame, so nothing waits."""
        row = [*told[:-1], number]
        self._told.numpy()[number] = np.asarray(row, np.float32)
        self._chosen.numpy()[number] = np.asarray(cameras, np.int32)
        wp.copy(self.room.told, self._told, src_offset=number * TOLD, count=TOLD)
        views = self.room.capacity.views
        wp.copy(self.room.sight.chosen, self._chosen, src_offset=number * views, count=views)

    def recorded(self) -> Any:
        """The graph of a step; recording does not run it."""
        with _no_collection(), wp.ScopedCapture(device=self.room.device) as capture:
            self.launch()
        return capture.graph

    def launch(self) -> None:
        """Every kernel of a step, in order."""
        self.show()
        self.judge()
        self.pull()
        self.update()

    def show(self) -> None:
        """From numbers to pictures."""
        self.decode()
        r, sight = self.room, self.room.sight
        seen = (sight.chosen, sight.cameras, sight.grid, sight.dirty)
        list_gaussians(r.moving, r.moving_count, r.cloud, *seen, r.device)
        draw(r.moving, r.still, sight, r.drawn, r.device)

    def decode(self) -> None:
        """From numbers to Gaussians."""
        r, t = self.room, self.room.trained
        c = r.capacity
        given = [t.values, r.base, r.decoders, r.sight.chosen, r.cloud, t.steps, t.rows, t.totals]
        own = r.cloud.means.shape[0]
        wp.launch(decode, dim=(own, c.anchors, c.slots), inputs=given, device=r.device)
        new = [r.trained_added.values, r.base, r.added, r.decoders, r.sight.chosen, r.cloud, r.moving_count]
        wp.launch(decode_added, dim=(own, c.added, c.slots), inputs=new, device=r.device)

    def judge(self) -> None:
        """From pictures to the loss and its gradient by their pixels."""
        r = self.room
        shape, seen = r.drawn.light.shape, [r.sight.chosen, r.sight.dirty, r.sight.grid, r.window]
        image, filmed = r.drawn.image, r.filmed
        wp.launch(blur_moments, dim=shape, inputs=[image, filmed, *seen, r.lines], device=r.device)
        judged = [image, filmed, *seen, r.lines, r.told, r.slopes, r.trained.totals]
        wp.launch(compare, dim=(*shape[:2], -(-shape[2] // LANES) * LANES), inputs=judged, device=r.device)
        wp.launch(blur_slopes, dim=shape, inputs=[r.slopes, *seen, r.lines], device=r.device)
        pulled = [image, filmed, *seen, r.lines, r.told, r.drawn.by_image]
        wp.launch(differentiate_loss, dim=shape, inputs=pulled, device=r.device)

    def pull(self) -> None:
        """From the pixels' gradient, and from what bits cost, to the numbers' gradient."""
        r, t = self.room, self.room.trained
        c = r.capacity
        differentiate(r.moving, r.still, r.sight, r.drawn, r.moving_count, r.cloud, r.by_cloud, r.device)
        given = [t.values, r.base, r.decoders, r.sight.chosen, r.cloud, r.by_cloud, t.pulls]
        wp.launch(differentiate_decode, dim=(c.anchors, c.slots), inputs=given, device=r.device)
        new = [r.trained_added.values, r.base, r.added, r.decoders, r.sight.chosen, r.cloud, r.by_cloud]
        to_new = [*new, r.trained_added.pulls]
        wp.launch(differentiate_added, dim=(c.added, c.slots), inputs=to_new, device=r.device)
        gathered = [t.values, r.base, t.steps, t.rows, r.table, t.pulls, r.told, t.totals, t.gradient]
        wp.launch(gather, dim=(c.anchors, LANES), inputs=gathered, device=r.device)

    def update(self) -> None:
        """Adam, the mean of the last steps, and the loss put down."""
        r, t, new = self.room, self.room.trained, self.room.trained_added
        c = r.capacity
        added = [r.added, new.pulls, r.told, new.first, new.second, new.values, new.mean, t.broken]
        wp.launch(adam_added, dim=(c.added, c.numbers_added), inputs=added, device=r.device)
        moments = [t.gradient, t.first, t.second, t.values, t.mean]
        given = [r.told, *moments, t.broken, t.totals, t.losses]
        wp.launch(adam, dim=c.numbers, inputs=given, device=r.device)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Python collects no garbage meanwhile: a picture that is freed may ask torch's stream, which ends a recording."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
