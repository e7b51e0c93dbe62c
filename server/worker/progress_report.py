"""The progress of a first frame as the server is told of it, and that kernels are compiled while nothing else goes on.

Numba keeps what it has compiled, so this is the first start on a machine, or the first one of another version.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from streamlod.core.train import Progress

COMPILING = "compiling for this machine, which takes some minutes, once"


class ProgressReport:
    """Tells how far training of a first frame is.

    Args:
        send: takes a report, of any thread: ``fraction``, ``loss`` and ``text``, or JSON of none.
    """

    def __init__(self, send: Callable[[dict[str, Any] | bytes], None]) -> None:
        self._send = send
        self._newest: dict[str, Any] | None = None
        self._depth = 0  # of compilations, as a kernel compiles those that it calls

    def trained(self, progress: Progress) -> None:
        """Tell how far it is."""
        told = {"fraction": float(progress.fraction), "loss": float(progress.loss), "text": str(progress.stage)}
        self._newest = told
        self._send(told)

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """Tell of kernels that any thread compiles while the context lasts, and after each what was told before it."""
        from numba.core import event

        begin, end = self._compile, self._compiled

        class _Compiling(event.Listener):
            def on_start(self, event: Any) -> None:
                begin()

            def on_end(self, event: Any) -> None:
                end()

        with event.install_listener("numba:compile", _Compiling()):
            yield

    def _compile(self) -> None:
        self._depth += 1  # Numba compiles in one thread at a time
        if self._depth == 1:
            self._interrupt((self._newest or {"fraction": 0.0, "loss": 0.0}) | {"text": COMPILING})

    def _compiled(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._interrupt(self._newest or b"null")

    def _interrupt(self, told: dict[str, Any] | bytes) -> None:
        with suppress(ConnectionError):  # the server has gone, which ends this process elsewhere
            self._send(told)
