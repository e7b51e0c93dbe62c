"""torch.compile where it works, the plain function where it does not."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import torch

_LOG = logging.getLogger(__name__)


class Compiled:
    """`function`, many small passes over memory, as few fused ones; for use where no gradients are recorded.

    Compiled at the first call, for any number of rows, since that changes from frame to frame. Where compiling fails
    (no Triton, no compiler, a driver too old), one sentence in the log says so and the function itself does the work.

    Args:
        function: of tensors to tensors; nothing that it does depends on their values.
        backend: as `torch.compile` takes it.
        device: type of device it is worth it for; elsewhere the function itself does the work.
    """

    def __init__(self, function: Callable[..., Any], backend: str = "inductor", device: str = "cuda") -> None:
        self.function, self._backend, self._device = function, backend, device
        self._ready: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        if arguments[0].device.type != self._device:
            return self.function(*arguments)
        if self._ready is None:
            self._ready = self._tried(arguments)
        return self._ready(*arguments)

    def _tried(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """The compiled function, where it works for these arguments: it is compiled when first run."""
        _LOG.info("compiling %s for this device, which takes some seconds once", self.function.__name__)
        compiled = torch.compile(self.function, backend=self._backend, dynamic=True)
        try:
            compiled(*arguments)
        except Exception as error:  # whatever the compiler's many parts raise
            reason = str(error).strip().partition("\n")[0]
            _LOG.warning("%s is not compiled and so runs slower: %s", self.function.__name__, reason)
            return self.function
        return compiled
