"""Errors as a user of the command line sees them: one sentence and an exit code."""

from __future__ import annotations

import sys

from streamlod.core.errors import BackendUnavailable, StreamlodError

FAULT = 2  # exit code of everything that we refuse
INTERRUPTED = 130


def explain(error: Exception) -> int:
    """Print the error as one sentence and return the exit code; unexpected errors keep their traceback."""
    if hasattr(error, "exit_code") and hasattr(error, "show"):  # wrong usage, which typer reports itself
        error.show()
        return int(error.exit_code)
    if isinstance(error, StreamlodError | OSError | ModuleNotFoundError):
        sys.stderr.write(f"streamlod: {' '.join(_sentence(error).split())}\n")
        return FAULT
    if type(error).__name__ == "Abort":
        return INTERRUPTED
    raise error


def _sentence(error: Exception) -> str:
    if isinstance(error, ModuleNotFoundError):
        remedy = "install it, for example with pip install 'streamlod[train,serve]'"
        return str(BackendUnavailable(f"the module {error.name}", remedy))
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)
