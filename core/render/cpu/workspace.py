"""Memory that kernels work in, kept from call to call.

Fresh pages cost as much as some kernels, so buffers are taken from a workspace, which only grows. A workspace belongs
to one rendering at a time; a pool hands them out, so that a viewer and a trainer may render at once.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_SPARE = 1 / 8  # growth beyond what was asked for, since the next frame may need a little more


class Workspace:
    """Named buffers."""

    def __init__(self) -> None:
        self._buffers: dict[str, NDArray[Any]] = {}

    def take(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """The buffer `name` as an array of `shape`, contents undefined; earlier arrays of that name are overwritten."""
        count = math.prod(shape)
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < count:
            buffer = self._buffers[name] = np.empty(count + int(count * _SPARE) + 64, dtype)
        return buffer[:count].reshape(shape)

    @property
    def size_bytes(self) -> int:
        """Memory held."""
        return sum(buffer.nbytes for buffer in self._buffers.values())


class Pool:
    """Free workspaces. Taking and giving back are atomic, from any thread."""

    def __init__(self, most: int = 4) -> None:
        self._free: deque[Workspace] = deque(maxlen=most)  # the oldest falls out when more come back

    def acquire(self) -> Workspace:
        """A free workspace, the one used last first, since it is the likeliest to be in cache; or a new one."""
        try:
            return self._free.pop()
        except IndexError:
            return Workspace()

    def release(self, workspace: Workspace) -> None:
        """Give a workspace back; none of its arrays may be used any more."""
        self._free.append(workspace)


POOL = Pool()  # work memory shared by all renderings of this process
