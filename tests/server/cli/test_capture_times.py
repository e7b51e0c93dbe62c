"""What `check` says of live cameras' times."""

from streamlod.server.cli.capture_times import judged_times
from streamlod.server.ingest.statistics import CameraStatistics, Statistics
from streamlod.server.ingest.sync.camera_track import CameraState, Counts
from streamlod.server.ingest.sync.clock import ClockSource
from streamlod.server.ingest.sync.time_fault import TimeFault


def test_a_camera_whose_times_may_be_off_by_more_than_half_a_frame_is_named() -> None:
    errors_ms = {"door": (3, ClockSource.NTP), "phone1": (16, ClockSource.STATED), "old": (40, ClockSource.ARRIVAL)}
    cameras = {
        name: CameraStatistics(CameraState.OK, source, error * 1_000_000, 0.0, Counts(), 1, "")
        for name, (error, source) in errors_ms.items()
    }
    told = Statistics(False, False, 0, 0, 0, 0, 0, cameras)
    (weak,) = judged_times(told, 30.0)
    assert weak.severity == "weak"
    assert weak.sentence == (
        "old: its capture times may be off by 40 ms, more than half a frame; they rest on arrival (docs/ingest.md)"
    )
    assert len(judged_times(told, 60.0)) == 2


def test_a_camera_whose_times_are_wrong_is_a_fault() -> None:
    wrong = CameraStatistics(CameraState.LATE, ClockSource.NTP, 0, 0.0, Counts(), 1, "", time_fault=TimeFault.STILL)
    good = CameraStatistics(CameraState.OK, ClockSource.NTP, 0, 0.0, Counts(), 1, "")
    (fault,) = judged_times(Statistics(False, False, 0, 0, 0, 0, 0, {"door": wrong, "hall": good}), 30.0)
    assert fault.severity == "fault"
    assert fault.sentence.startswith("door: its times stand still: restart it and set its clock (NTP)")
