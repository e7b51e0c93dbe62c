"""Times in a connection: those of its frames, and what its sender says of the wall clock."""

from __future__ import annotations

import struct
from typing import Any

import av
import av.frame

from streamlod.server.ingest.sync.clock import CaptureClock

_REPORT_NS = 1_000_000_000


class Reports:
    """Tells a clock what the sender of a connection reports (PyAV 18.1 and newer).

    FFmpeg repeats the last report on all packets; one a second, and every change, is told.

    Args:
        clock: of the connection.
    """

    def __init__(self, clock: CaptureClock) -> None:
        self._clock = clock
        self._last: tuple[int, int] | None = None

    def note(self, packet: av.Packet[Any]) -> None:
        """A packet has come."""
        report = _report(packet)
        if report is not None and self._is_news(report):
            self._clock.observe_report(*report)
            self._last = report

    def _is_news(self, report: tuple[int, int]) -> bool:
        last = self._last
        if last is None or report[0] - last[0] >= _REPORT_NS or report[0] < last[0]:
            return True
        return abs((report[1] - report[0]) - (last[1] - last[0])) > 1_000_000


def media_ns_of(timed: av.frame.Frame | av.Packet[Any]) -> int | None:
    """The time of a frame or a packet on its connection's own scale, in nanoseconds."""
    if timed.pts is None or timed.time_base is None:
        return None
    return timed.pts * 1_000_000_000 * timed.time_base.numerator // timed.time_base.denominator


def bytes_of(buffer: Any) -> bytes:
    """The bytes of a buffer of PyAV, whose type stubs do not declare that protocol."""
    return bytes(buffer)


def _report(packet: av.Packet[Any]) -> tuple[int, int] | None:
    """(presentation time, sender's wall clock) in nanoseconds, if the sender reports them."""
    if (media_ns := media_ns_of(packet)) is None or not packet.has_sidedata("prft"):
        return None
    for data in packet.iter_sidedata():
        raw = bytes_of(data)
        if str(data.data_type) == "prft" and len(raw) >= 8:
            return media_ns, struct.unpack_from("<q", raw)[0] * 1000
    return None
