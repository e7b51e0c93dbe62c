"""Sentences about cameras that deliver nothing."""

from __future__ import annotations

from streamlod.server.worker.ingest_report import complaint


def _camera(state: str = "ok", fault: str = "", refused: str = "") -> dict[str, str]:
    return {"state": state, "fault": fault, "refused": refused}


def test_one_lost_camera_is_named_and_several_are_counted() -> None:
    """A rig that loses most of its cameras is one short sentence, with each fault once."""
    lost = _camera("lost", "Connection refused")
    assert complaint({"cameras": {"cam1": _camera(), "cam2": _camera()}}) == ""
    assert complaint({"cameras": {"cam1": lost, "cam2": _camera()}}) == "camera cam1 is lost (Connection refused)"
    rig = {"cam1": lost, "cam2": _camera(), "cam3": lost, "cam4": _camera("lost"), "cam5": _camera()}
    assert complaint({"cameras": rig}) == "3 of 5 cameras are lost: cam1, cam3, cam4 (Connection refused)"
    rig["cam5"] = _camera(refused="films at another rate")
    assert complaint({"cameras": rig}).endswith("; camera cam5 films at another rate")
