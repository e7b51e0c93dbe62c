"""The folder of sockets: whatever ends its process, the next one cleans up, and leaves alone what is in use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from streamlod.server.ingest.push import socket_folder
from streamlod.server.ingest.push.socket_folder import SocketFolder

_HOLD = """
import sys
from streamlod.server.ingest.push.socket_folder import SocketFolder
folder = SocketFolder()
folder.new_socket().touch()
print("ready", flush=True)
sys.stdin.read()
"""


def test_a_killed_process_leaves_nothing_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "streamlod-of-something-else").mkdir()
    process = subprocess.Popen([sys.executable, "-c", _HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        held = next(path.parent for path in tmp_path.glob("*/lock"))
        own = SocketFolder()
        assert held.is_dir()  # in use
        assert own.new_socket().parent.stat().st_mode & 0o777 == 0o700
        own.close()
        process.kill()
        process.wait()
    assert held.is_dir()
    SocketFolder().close()
    assert [path.name for path in tmp_path.iterdir()] == ["streamlod-of-something-else"]


def test_a_folder_that_is_being_made_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process cleans up between the lock's file and the lock."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    take = socket_folder._try_lock

    def after_another_cleaned_up(descriptor: int) -> bool:
        monkeypatch.setattr(socket_folder, "_try_lock", take)
        SocketFolder().close()
        return take(descriptor)

    monkeypatch.setattr(socket_folder, "_try_lock", after_another_cleaned_up)
    folder = SocketFolder()
    assert folder.new_socket().parent.is_dir()
    folder.close()
