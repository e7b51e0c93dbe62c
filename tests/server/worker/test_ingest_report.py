"""Sentences about cameras that deliver nothing."""

from __future__ import annotations

from typing import Any

from streamlod.server.ingest.sync.time_fault import TimeFault
from streamlod.server.worker.ingest_report import complaint


def _camera(state: str = "ok", fault: str = "", refused: str = "", silent_ns: int | None = None) -> dict[str, Any]:
    return {"state": state, "fault": fault, "refused": refused, "silent_ns": silent_ns}


def test_one_lost_camera_is_named_and_several_are_counted() -> None:
    """A rig that loses most of its cameras is one short sentence, with each fault once."""
    lost = _camera("lost", "Connection refused")
    assert complaint({"cameras": {"cam1": _camera(), "cam2": _camera()}}) == ""
    assert complaint({"cameras": {"cam1": lost, "cam2": _camera()}}) == "camera cam1 is lost (Connection refused)"
    rig = {"cam1": lost, "cam2": _camera(), "cam3": lost, "cam4": _camera("lost"), "cam5": _camera()}
    assert complaint({"cameras": rig}) == "3 of 5 cameras are lost: cam1, cam3, cam4 (Connection refused)"
    rig["cam5"] = _camera(refused="films at another rate")
    assert complaint({"cameras": rig}).endswith("; camera cam5 films at another rate")


def test_a_knocked_camera_is_named_with_what_to_do_and_not_when_it_is_lost_as_well() -> None:
    knocked = _camera() | {"knocked": True}
    assert complaint({"cameras": {"cam1": _camera(), "cam2": knocked}}).startswith(
        "camera cam2 was knocked: put it back"
    )
    lost = _camera("lost", "Connection refused") | {"knocked": True}
    assert complaint({"cameras": {"cam1": lost}}) == "camera cam1 is lost (Connection refused)"


def test_a_camera_with_wrong_times_is_named_with_what_to_do_and_not_when_it_is_lost_as_well() -> None:
    said = {
        "still": "times stand still: restart it",
        "back": "times run backwards: restart it",
        "far": "times are far from those of the other cameras: set its clock (NTP)",
    }
    assert set(said) == set(TimeFault)
    for fault, words in said.items():
        wrong = {"cam1": _camera(), "cam2": _camera("late") | {"time_fault": fault}}
        assert complaint({"cameras": wrong}).startswith(f"camera cam2's {words}; until then ")
        wrong["cam2"] |= {"state": "lost", "fault": "Connection refused"}
        assert complaint({"cameras": wrong}) == "camera cam2 is lost (Connection refused)"
    assert complaint({"cameras": {"cam2": _camera() | {"time_fault": None}}}) == ""


def test_a_silence_is_worth_a_word_after_five_seconds_and_a_fault_or_no_picture_at_all_is_at_once() -> None:
    """A machine that trains a first frame takes pictures late, of cameras that are well."""
    states = {4: "", 6: "camera cam1 is lost"}
    for seconds, said in states.items():
        silent = _camera("lost", silent_ns=seconds * 1_000_000_000)
        assert complaint({"cameras": {"cam1": silent, "cam2": _camera()}}) == said
    failed = _camera("lost", "Connection refused", silent_ns=1_500_000_000)
    assert complaint({"cameras": {"cam1": failed}}) == "camera cam1 is lost (Connection refused)"
    assert complaint({"cameras": {"cam1": _camera("lost")}}) == "camera cam1 is lost"


def test_poses_that_do_not_hold_are_told_after_cameras_that_are_lost() -> None:
    said = "cam2 and cam3 are exchanged: swap their names, as each shows what the other's pose sees"
    assert complaint({"cameras": {"cam2": _camera()}, "poses": [said]}) == said
    lost = {"cam1": _camera("lost", fault="Connection refused"), "cam2": _camera()}
    assert complaint({"cameras": lost, "poses": [said]}) == f"camera cam1 is lost (Connection refused); {said}"
