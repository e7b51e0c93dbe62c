"""All recordings of a server, below one folder."""

from __future__ import annotations

import logging
import os
import re
import sys
from pathlib import Path

from streamlod.core.errors import InputError
from streamlod.server.pipeline.spec import STREAM_ID
from streamlod.server.settings import Retention
from streamlod.server.stream.recording.disk import Disk
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.recording.sealing import Seal
from streamlod.server.stream.recording.stored_stream import PRIVATE_FILE, PRIVATE_FOLDER, StoredStream, read_stored

_LOG = logging.getLogger(__name__)


class Store:
    """All recordings below one folder.

    Attributes:
        folder: see below.
        seal: for what is sealed there.
        disk: that holds the recordings.

    Args:
        folder: made if it is missing.
        retention: what to keep.

    Raises:
        InputError: the folder cannot be used.
    """

    def __init__(self, folder: Path, retention: Retention) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER)
            self._lock = _lock(folder)
            (folder / "streams").mkdir(exist_ok=True, mode=PRIVATE_FOLDER)
            self.seal = Seal(folder / "secret.key")
        except OSError as error:
            fault = f"cannot hold recordings ({error.strerror or error})"
            mend = f"give the folder to user {os.getuid()}, or " if isinstance(error, PermissionError) else ""
            raise InputError(folder, f"{fault}; {mend}choose another --state-dir") from error
        self._recordings: list[Recording] = []
        self.disk = Disk(folder / "streams", retention)

    def recording(self, stream: str) -> Recording:
        """The recording of a stream, repaired if the last run was interrupted; what fails is its `fault`."""
        recording = Recording(self.disk, stream)
        self._recordings = [*(each for each in self._recordings if not each.is_erased), recording]
        return recording

    def stored_streams(self) -> dict[str, StoredStream]:
        """Streams of which something is kept, by id; what else lies among them is reported."""
        found = {}
        for path in sorted((self.folder / "streams").iterdir()):
            if not (path.is_dir() and re.fullmatch(STREAM_ID, path.name)):
                _LOG.warning("%s is no stream's folder and is left alone", path)
            elif (stored := read_stored(path)) is not None:
                found[path.name] = stored
        return found

    def close(self) -> None:
        """Finish queued work, close all open segments."""
        for recording in self._recordings:
            self.disk.submit(recording.finish)
        self.disk.close()
        os.close(self._lock)

    def retain(self) -> None:
        """Delete what has become too old, soon; to be called now and then, as a stream may get no packets."""
        for recording in self._recordings:
            self.disk.submit(recording.retain)


def _lock(folder: Path) -> int:
    """A descriptor that holds the folder for this process; a second server on one folder would tear its files."""
    descriptor = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, PRIVATE_FILE)
    if sys.platform == "win32":  # which has no such locks
        return descriptor
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise InputError(folder, "is used by another server; stop it, or choose another --state-dir") from error
    return descriptor
