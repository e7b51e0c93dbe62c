"""Numbers that a GPU works out, read by the host a step later, when the GPU has other work to go on with."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


class HostCopy:
    """The numbers of `values`, on their way to the host from now on.

    On a GPU the copy stands in line behind the work that was asked for before, and nobody waits for it until `read`. By
    then the GPU should have been given more to do, or it stands still until the host has gone on.
    """

    def __init__(self, values: Tensor) -> None:
        self._values = values.detach().to("cpu", non_blocking=True)  # torch takes pinned memory for it
        self._arrival: Any = None
        if values.device.type != "cpu":
            self._arrival = torch.get_device_module(values.device).current_stream().record_event()

    @property
    def is_here(self) -> bool:
        """Whether the numbers were the host's from the beginning, so that reading them waits for nothing."""
        return self._arrival is None

    def read(self) -> Tensor:
        """The numbers, once they have arrived."""
        if self._arrival is not None:
            self._arrival.synchronize()
        return self._values
