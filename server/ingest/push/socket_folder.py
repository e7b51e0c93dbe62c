"""A folder for the sockets of workers: this user's alone, and gone when its process is, however that ends."""

from __future__ import annotations

import os
import secrets
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

_PREFIX = "streamlod-"
_LOCK = "lock"


class SocketFolder:
    """A new folder in the system's folder of temporary files, because a socket's path may have 107 bytes only.

    A process holds a lock on its folder while it runs; folders without one were left by processes that were killed,
    and are removed here.
    """

    def __init__(self) -> None:
        _remove_abandoned(Path(tempfile.gettempdir()))
        self._path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        made = self._path / "new"
        self._lock = os.open(made, os.O_CREAT | os.O_RDWR, 0o600)
        _try_lock(self._lock)
        made.rename(self._path / _LOCK)  # only now may others try it, and it is held

    def new_socket(self) -> Path:
        """A path in the folder that nothing has used."""
        return self._path / secrets.token_hex(8)

    def close(self) -> None:
        """Remove the folder and what is in it."""
        shutil.rmtree(self._path, ignore_errors=True)
        os.close(self._lock)


def _remove_abandoned(parent: Path) -> None:
    for folder in parent.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # others' folders, and those that another process removes at the same time
            if folder.stat().st_uid != os.getuid():
                continue
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW)
            try:
                if _try_lock(lock):
                    shutil.rmtree(folder)
            finally:
                os.close(lock)


def _try_lock(descriptor: int) -> bool:
    """Whether the lock could be taken, which ends with the process."""
    if sys.platform == "win32":  # which has no such locks
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
