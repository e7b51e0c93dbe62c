"""What a state folder keeps over versions of the program, damage and a full disk."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from streamlod.codec.container import SlodWriter
from streamlod.server.settings import Retention
from streamlod.server.stream.recording.store import Store
from streamlod.server.stream.recording.stored_stream import StoredStream, read_stored, write_stored
from tests.server.conftest import Clip


def with_folder(state: Path) -> None:
    """Make a state folder with a stream in it."""
    store = Store(state, Retention())
    store.recording("a").note()
    store.close()


def test_fields_of_another_version_are_kept_for_it(tmp_path: Path) -> None:
    write_stored(tmp_path, StoredStream(epoch=3, definition={"play": "x"}))
    path = tmp_path / "stream.json"
    values = json.loads(path.read_text()) | {"new_field": {"a": [1]}, "others": 7}
    path.write_text(json.dumps(values))
    stored = read_stored(tmp_path)
    assert stored is not None
    assert (stored.epoch, stored.definition) == (3, {"play": "x"})
    write_stored(tmp_path, stored)
    assert json.loads(path.read_text()) == values


@pytest.mark.parametrize("text", ["", "[]", "{", '{"epoch": "3"}', "null", "[" * 5000], ids=len)
def test_a_damaged_file_is_set_aside_and_not_overwritten(tmp_path: Path, text: str) -> None:
    (tmp_path / "stream.json").write_text(text)
    assert read_stored(tmp_path) is None
    write_stored(tmp_path, StoredStream())
    assert (tmp_path / "stream.damaged").read_text() == text


def test_a_stream_that_is_known_writes_nothing_at_the_start(tmp_path: Path) -> None:
    store = Store(tmp_path, Retention())
    store.recording("a").note(epoch=4)
    store.close()
    path = tmp_path / "streams" / "a" / "stream.json"
    before = path.stat()
    store = Store(tmp_path, Retention())
    assert store.recording("a").stored.epoch == 4
    store.close()
    after = path.stat()
    assert (before.st_mtime_ns, before.st_ino) == (after.st_mtime_ns, after.st_ino)


def test_a_group_that_cannot_be_repaired_is_played_all_the_same(
    tmp_path: Path, clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A group that was cut short by a crash gets its index when there is room."""
    store = Store(tmp_path, Retention())
    store.recording("a").note(definition={"play": "x"})
    store.close()
    cut = tmp_path / "streams" / "a" / "000001-0000000000.slod"
    cut.write_bytes(clip.path.read_bytes()[:-1000])

    def full(writer: SlodWriter) -> None:
        writer._file.close()
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(SlodWriter, "close", full)
        store = Store(tmp_path, Retention())
        recording = store.recording("a")
        assert (len(recording.segments), recording.stored.definition) == (1, {"play": "x"})
        store.close()
    store = Store(tmp_path, Retention())
    assert len(store.recording("a").segments) == 1
    store.close()


def test_groups_that_this_version_cannot_read_are_left_alone(tmp_path: Path, clip: Clip) -> None:
    """A rollback, and a disk that reads badly, cost no recording; only what a crash cut short is deleted."""
    with_folder(tmp_path)
    whole = clip.path.read_bytes()
    folder = tmp_path / "streams" / "a"
    kept = {
        "000001-0000000000.slod": whole[:4] + b"\2" + whole[5:],  # of a newer file version
        "000002-0000000000.slod": whole[:16] + rb"\9" + whole[17:],  # whose packets are of a newer version
        "000003-0000000000.slod": b"zeros" * 1000,
    }
    cut = {"000004-0000000000.slod": whole[:200], "000005-0000000000.slod": b"", "000006-0000000000.slod": whole[:10]}
    for name, data in (kept | cut).items():
        (folder / name).write_bytes(data)
    (folder / "000007-0000000000.slod").write_bytes(whole)
    store = Store(tmp_path, Retention())
    assert [segment.first.epoch for segment in store.recording("a").segments] == [7]
    store.close()
    found = {path.name: path.read_bytes() for path in folder.glob("*.slod")}
    assert found == kept | {"000007-0000000000.slod": whole}


def test_a_whole_group_is_not_written_again(tmp_path: Path, clip: Clip) -> None:
    with_folder(tmp_path)
    path = tmp_path / "streams" / "a" / "000001-0000000000.slod"
    path.write_bytes(clip.path.read_bytes())
    before = path.stat()
    store = Store(tmp_path, Retention())
    assert len(store.recording("a").segments) == 1
    store.close()
    assert (path.stat().st_mtime_ns, path.stat().st_ino) == (before.st_mtime_ns, before.st_ino)


def test_an_empty_key_that_a_full_disk_left_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "secret.key").touch()
    store = Store(tmp_path, Retention())
    assert store.seal.open(store.seal.close("rtsp://a:b@c/")) == "rtsp://a:b@c/"
    store.close()
