"""How fast a camera films while it films: times without pictures are told elsewhere, and do not count."""

from __future__ import annotations

from dataclasses import dataclass

_SECOND_NS = 1_000_000_000
_SILENT_NS = _SECOND_NS  # between two pictures: more is no slow camera, but one that was away


@dataclass(frozen=True, slots=True)
class Pace:
    """Pictures that one camera has delivered so far.

    Attributes:
        pictures: those that came after another one, without a silence between.
        filming_ns: between each of them and the one before it, in all.
        newest_ns: when the last picture came; None before the first.
    """

    pictures: int = 0
    filming_ns: int = 0
    newest_ns: int | None = None

    def then(self, now_ns: int) -> Pace:
        """The pace with one more picture, which came now."""
        if self.newest_ns is None or now_ns - self.newest_ns > _SILENT_NS:
            return Pace(self.pictures, self.filming_ns, now_ns)
        return Pace(self.pictures + 1, self.filming_ns + now_ns - self.newest_ns, now_ns)

    def since(self, before: Pace, at_least_seconds: float) -> float | None:
        """Pictures a second since then; None where it has not filmed for so long."""
        filming_ns = self.filming_ns - before.filming_ns
        if filming_ns < at_least_seconds * _SECOND_NS:
            return None
        return (self.pictures - before.pictures) * _SECOND_NS / filming_ns
