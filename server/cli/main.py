"""Entry point of the command `streamlod`."""

from __future__ import annotations

import logging
import signal
import sys
import traceback
from typing import Any, NoReturn

from streamlod.core.background_log import LOG_FORMAT
from streamlod.server.cli import declared  # noqa: F401  adds the commands
from streamlod.server.cli.app import app
from streamlod.server.cli.explain import INTERRUPTED, explain

__all__ = ["app", "main"]


def main() -> NoReturn:
    """Entry point: one sentence and exit code 2 for everything refused."""
    arguments = [argument for argument in sys.argv[1:] if argument not in {"--debug", "--verbose"}]
    debug, verbose = "--debug" in sys.argv, "--verbose" in sys.argv
    _configure_logging(verbose or debug)
    signal.signal(signal.SIGTERM, _terminate)
    try:
        code = app(args=arguments, standalone_mode=False)
    except KeyboardInterrupt:  # typer takes those of a command, and returns the same code
        code = INTERRUPTED
    except Exception as error:
        if debug:
            traceback.print_exc()
        code = explain(error)
    if code == INTERRUPTED:
        sys.stderr.write("\ninterrupted\n")
    raise SystemExit(code or 0)


def _configure_logging(verbose: bool) -> None:
    level = logging.DEBUG if verbose else logging.INFO
    logging.basicConfig(stream=sys.stderr, format=LOG_FORMAT, level=logging.WARNING)
    logging.getLogger("streamlod").setLevel(level)


def _terminate(_: int, __: Any) -> NoReturn:
    raise KeyboardInterrupt
