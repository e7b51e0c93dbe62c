"""Files that are written whole or not at all, even if the process or the machine stops in between.

The bytes go to a temporary file in the same folder, are flushed to the disk, and only then take the name of the file,
in one step of the file system. What is interrupted leaves the earlier file as it was.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from streamlod.core.errors import InputError


def check_output(path: Path) -> None:
    """Make the folder of a file that is to be written later; InputError, before any work, if it cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})") from error
    if path.is_dir():
        raise InputError(path, "is a folder; name a file")
    if not os.access(path.parent, os.W_OK):
        raise InputError(path, "cannot be written (no permission for the folder)")


def nearest_folder(folder: Path) -> Path:
    """The folder itself, or the nearest one above it that is there."""
    return next(each for each in (folder, *folder.absolute().parents) if each.is_dir())


def temporary_beside(path: Path) -> Path:
    """A name in the folder of `path` that nobody else uses, hidden, to be given to `put_in_place`."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")


def put_in_place(temporary: Path, path: Path) -> None:
    """Flush a complete file to the disk and rename it to `path`, in place of what is there.

    Raises:
        OSError: it could not be flushed or renamed.
    """
    with temporary.open("r+b") as file:
        os.fsync(file.fileno())
    temporary.replace(path)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A name to write a file under, which becomes `path` when the context ends, and goes if that is by an exception.

    Raises:
        OSError: as `put_in_place`.
    """
    temporary = temporary_beside(path)
    try:
        yield temporary
        put_in_place(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes, *, private: bool = False) -> None:
    """Write a whole file, in a folder that is there.

    Args:
        private: only the user who runs this may read it.

    Raises:
        InputError: it cannot be written; what was there before stays.
    """
    try:
        with written_whole(path) as temporary:
            if private:
                temporary.touch(mode=0o600)
            temporary.write_bytes(data)
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})") from error


def write_text(path: Path, text: str, *, private: bool = False) -> None:
    """Write a whole file of UTF-8 text; see `write_bytes`."""
    write_bytes(path, text.encode(), private=private)
