"""Files that are whole or not there: killed writers, full disks, several writers at once."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from streamlod.core.files import put_in_place, temporary_beside, write_bytes, write_text

SIZE = 3_000_000
VALUES = [bytes([value]) * SIZE for value in (65, 66)]
ENDLESS = f"""
import sys
from pathlib import Path
from streamlod.core.files import write_bytes
while True:
    for value in (65, 66):
        write_bytes(Path(sys.argv[1]), bytes([value]) * {SIZE})
"""
SMALL_DISK = f"""
import resource, signal, sys
from pathlib import Path
from streamlod.core.errors import InputError
from streamlod.core.files import write_bytes
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_bytes(Path(sys.argv[1]), bytes({SIZE}))
except InputError as error:
    print(error)
"""


def test_what_is_written_takes_the_place_of_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_text(path, "eins")
    write_text(path, "zwö")
    assert path.read_bytes() == "zwö".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_a_writer_that_is_killed_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, VALUES[0])
    for attempt in range(5):
        with subprocess.Popen([sys.executable, "-c", ENDLESS, str(path)]) as writer:
            latest = time.monotonic() + 30
            while not any(tmp_path.glob(".a.bin.*")) and time.monotonic() < latest:
                time.sleep(0.001)  # until it is in the midst of its work
            time.sleep(0.003 * attempt)
            writer.kill()
        assert path.read_bytes() in VALUES
        for unfinished in tmp_path.glob(".a.bin.*"):
            unfinished.unlink()


def test_a_full_disk_is_told_and_leaves_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, VALUES[0])
    done = subprocess.run(
        [sys.executable, "-c", SMALL_DISK, str(path)], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.startswith(f"{path}: cannot be written (")
    assert path.read_bytes() == VALUES[0]
    assert list(tmp_path.iterdir()) == [path]


def test_places_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "folder", tmp_path / "none" / "a.bin"):
        with pytest.raises(InputError, match="cannot be written"):
            write_bytes(path, b"x")
    assert list(tmp_path.iterdir()) == [tmp_path / "folder"]


def test_two_writers_of_one_file_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    threads = [
        threading.Thread(target=lambda value=value: [write_bytes(path, value) for _ in range(5)]) for value in VALUES
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert path.read_bytes() in VALUES
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_written_by_other_means_is_put_in_place(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    temporary = temporary_beside(path)
    assert temporary.parent == path.parent
    assert temporary != temporary_beside(path)
    temporary.write_bytes(b"x")
    put_in_place(temporary, path)
    assert list(tmp_path.iterdir()) == [path]
