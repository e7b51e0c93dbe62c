"""What `check` says of the disk on which an evening is to be kept."""

from pathlib import Path

from streamlod.server.cli.room import judged_room
from streamlod.server.settings import Retention, Settings
from tests.small_disk import mounted_disk


def test_a_disk_with_little_room_is_told_before_the_evening(tmp_path: Path) -> None:
    with mounted_disk(tmp_path / "disk") as disk:
        settings = Settings(state=disk / "evenings")
        assert [each.sentence for each in judged_room(settings)] == [
            f"the disk of {disk}/evenings has 4 MB for what is streamed, beyond the 5 % that recordings leave free; "
            "make room, or name another folder as `state`"
        ]
        (disk / "films").write_bytes(bytes(4_050_000))
        (full,) = judged_room(settings)
        assert "is full, so that nothing streamed is kept, beyond the 5 %" in full.sentence
        (left,) = judged_room(Settings(state=disk, retention=Retention(reserve_fraction=0.0)))
        assert "has 0 MB for what is streamed; make room" in left.sentence


def test_room_enough_and_nothing_to_keep_are_no_findings(tmp_path: Path) -> None:
    assert judged_room(Settings()) == []
    assert judged_room(Settings(state=tmp_path, retention=Retention(bytes=1_000_000, reserve_fraction=0.0))) == []
