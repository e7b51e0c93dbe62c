"""Pairs the pictures of many cameras by time. No clock and no I/O here: the caller passes the time.

There are two kinds of time: the capture time of pictures, and `now_ns`, which is monotonic with any origin. Only
differences of `now_ns` are used, so a step of a wall clock shows as a jump of capture times alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from statistics import median_low

from streamlod.core.camera.grid import Grid, best_phase, period_of, phase_of
from streamlod.server.ingest.sync.camera_track import CameraState, CameraTrack, Counts
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.time_fault import TimeFault

_SECOND_NS = 1_000_000_000
_AHEAD_NS = _SECOND_NS  # a picture this much earlier than its camera rig's usual delay has a wrong time
_BEHIND_NS = 10 * _SECOND_NS
_STRAYS = 3  # wrong times in a row of most cameras: the clock they share was stepped
_SMOOTHING = 0.1
_MAX_PATIENCE = 8  # times the deadline that slow cameras are waited for
_SETTLED = 0.8  # length of the smoothed phase vector from which it is acted on
_OFF_CENTRE, _GAIN = 0.35, 0.1  # parts of a period: when the grid is moved, and what it must be good for


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """A closed instant.

    Attributes:
        number: increases by one each period, across gaps and clock steps too.
        capture_ns: its place on the grid, in the cameras' time.
        pictures: one for each camera, in their order; None where one is missing.
    """

    number: int
    capture_ns: int
    pictures: tuple[Picture | None, ...]


@dataclass(slots=True)
class _Open:
    first_ns: int
    pictures: dict[str, Picture] = field(default_factory=dict)


class Synchroniser:
    """Pairs pictures by capture time on a grid of instants.

    A jitter buffer: an instant is given out, in order, as soon as every camera that delivers has sent its picture or a
    later one, at the latest `deadline_ns` after its first picture; with less than `quorum` pictures, it is dropped. The
    first one, of which a scene is trained, has those of all cameras, unless in `gather_ns` they cannot be had. A
    picture goes into the nearest instant or nowhere. Memory is bounded: a picture is accepted at most a second ahead,
    and instants close at their deadline.

    Args:
        cameras: names, in the order of an instant's pictures.
        fps: instants a second.
        quorum: pictures that an instant needs; all by default.
        deadline_ns: two periods by default; up to eight times that where a camera's pictures usually come so late.
        lost_ns: silence after which a camera isn't waited for any more.
        gather_ns: how long to wait at first for one camera more, and for an instant with the pictures of all: phones
            begin to film one after the other.
    """

    def __init__(
        self,
        cameras: Sequence[str],
        fps: float,
        *,
        quorum: int | None = None,
        deadline_ns: int | None = None,
        lost_ns: int = _SECOND_NS,
        gather_ns: int = 10 * _SECOND_NS,
    ) -> None:
        self._tracks = {name: CameraTrack() for name in cameras}
        if not cameras or len(self._tracks) < len(cameras):
            raise ValueError("cameras need names, each its own")
        self._quorum = len(cameras) if quorum is None else quorum
        if not 1 <= self._quorum <= len(cameras):
            raise ValueError(f"a quorum of {quorum} does not fit {len(cameras)} cameras")
        self._period = period_of(fps)
        self._deadline_ns = round(2 * self._period) if deadline_ns is None else deadline_ns
        self._lost_ns, self._gather_ns = lost_ns, gather_ns
        self._grid: Grid | None = None
        self._began_ns: int | None = None  # when the newest of the first cameras came
        self._has_given = False
        self._open: dict[int, _Open] = {}
        self._closed, self._closed_ns = -1, 0
        self._delay_ns = self._followed_ns = self._now_ns = 0
        self.dropped = self.steps = self.shifts = 0  # instants below quorum, clock steps of all, moves of the grid

    @property
    def pending(self) -> int:
        """Number of instants in memory."""
        return len(self._open)

    def counts(self) -> dict[str, Counts]:
        """A copy of the counters of each camera."""
        return {name: replace(track.counts) for name, track in self._tracks.items()}

    def states(self, now_ns: int) -> dict[str, CameraState]:
        """The state of each camera."""
        return {name: track.state(now_ns, self._lost_ns) for name, track in self._tracks.items()}

    def silences_ns(self, now_ns: int) -> dict[str, int | None]:
        """How long no picture of each camera has come; None before the first, and after it has gone."""
        came = {name: track.arrived_ns for name, track in self._tracks.items()}
        return {name: None if at_ns is None else now_ns - at_ns for name, at_ns in came.items()}

    def time_faults(self) -> dict[str, TimeFault | None]:
        """The fault of each camera's times; None where there is none, or not for long."""
        return {name: track.times.fault() for name, track in self._tracks.items()}

    def is_degraded(self, now_ns: int) -> bool:
        """Whether some camera is lost."""
        return CameraState.LOST in self.states(now_ns).values()

    def deadline_ns(self) -> int | None:
        """When `poll` is due if no picture comes, or None while no instant is open."""
        if self._grid is None:
            return None if self._began_ns is None else self._began_ns + self._gather_ns
        first = min((instant.first_ns for instant in self._open.values()), default=None)
        return None if first is None else first + self._patience(self._alive())

    def push(self, picture: Picture, now_ns: int) -> list[Instant]:
        """Take a picture; returns the instants that are ready.

        Raises:
            KeyError: no such camera.
        """
        track = self._tracks[picture.camera]
        self._now_ns = now_ns
        ready = self._close_due(now_ns)
        track.counts.received += 1
        track.is_back = track.is_back or track.state(now_ns, self._lost_ns) is CameraState.LOST
        track.arrived_ns = now_ns
        track.delay_ns = now_ns - picture.capture_ns
        is_stray = self._grid is not None and self._is_stray(track, now_ns)
        track.times.note(picture, now_ns, is_far=is_stray)
        if self._grid is None:
            self._began_ns = now_ns if self._began_ns is None or not track.held else self._began_ns
            track.held.append(picture)
            return self._begin(now_ns)
        if is_stray:
            return ready + self._restart_if_all_strayed(now_ns)
        if track.is_back:
            ready += self._welcome(track, picture, now_ns)
        self._place(picture, now_ns)
        return ready + self._close_due(now_ns)

    def poll(self, now_ns: int) -> list[Instant]:
        """The instants whose deadline has passed."""
        self._now_ns = now_ns
        if self._grid is None and self._began_ns is not None:
            return self._begin(now_ns)
        return self._close_due(now_ns)

    def leave(self, camera: str, now_ns: int) -> list[Instant]:
        """A camera has gone; it is not waited for until it delivers again."""
        self._tracks[camera].arrived_ns = None
        return self.poll(now_ns)

    def finish(self, now_ns: int) -> list[Instant]:
        """The instants still open, at the end."""
        ready = [] if self._grid or self._began_ns is None else self._begin(self._began_ns + self._gather_ns)
        return ready + self._flush(now_ns)

    def _alive(self) -> list[CameraTrack]:
        """Cameras that are waited for: they delivered lately, with plausible times."""
        return [
            track
            for track in self._tracks.values()
            if track.state(self._now_ns, self._lost_ns) is not CameraState.LOST and track.strays < _STRAYS
        ]

    def _patience(self, alive: list[CameraTrack]) -> int:
        """How long an instant stays open after its first picture; longer where a camera is always late."""
        lags = [track.lag_ns for track in alive]
        wanted = max(lags) - min(lags) + self._deadline_ns / 2 if lags else 0
        return round(min(max(self._deadline_ns, wanted), _MAX_PATIENCE * self._deadline_ns))

    def _begin(self, now_ns: int) -> list[Instant]:
        """Start the grid once all cameras have delivered, or have been waited for long enough."""
        assert self._began_ns is not None
        seen = [track for track in self._tracks.values() if track.held]
        if not seen or (len(seen) < len(self._tracks) and now_ns - self._began_ns < self._gather_ns):
            return []
        self._delay_ns, self._followed_ns = median_low([track.delay_ns for track in seen]), now_ns
        held = sorted((picture for track in seen for picture in track.held), key=lambda picture: picture.capture_ns)
        self._lay(self._closed + 1, [track.held[-1].capture_ns for track in seen])
        assert self._grid is not None
        begin = max(track.held[0].capture_ns for track in seen if not self._is_off(track))
        self._grid = replace(self._grid, anchor_ns=self._grid.time_of(self._grid.instant_of(begin)))
        self._closed_ns = now_ns
        for track in self._tracks.values():
            track.held.clear()
        for picture in held:
            if (
                not self._is_off(self._tracks[picture.camera])
                and self._grid.instant_of(picture.capture_ns) > self._closed
            ):
                self._place(picture, now_ns)
        return self._close_due(now_ns)

    def _welcome(self, track: CameraTrack, picture: Picture, now_ns: int) -> list[Instant]:
        """Move the grid at once for a camera that came back with another phase, before its pictures are paired.

        Moved only once the phase is smoothed, a camera's pictures would change instants after they had been given out.
        """
        assert self._grid is not None
        track.is_back, track.turn = False, self._grid.turn_of(picture.capture_ns)
        return self._shift_if_off_centre(self._alive(), now_ns)

    def _lay(self, number: int, captures: list[int]) -> None:
        """A grid for cameras whose latest capture times are these; the first instant is about the first of them."""
        grid = Grid(self._period, number, captures[0])
        shift = best_phase([phase_of(grid.turn_of(capture)) for capture in captures])
        self._grid = replace(grid, anchor_ns=grid.anchor_ns + round(shift * self._period))
        for track in self._tracks.values():
            track.newest, track.strays, track.turn, track.is_back = None, 0, 0, False

    def _is_off(self, track: CameraTrack) -> bool:
        return not self._delay_ns - _AHEAD_NS <= track.delay_ns <= self._delay_ns + _BEHIND_NS

    def _is_stray(self, track: CameraTrack, now_ns: int) -> bool:
        """Whether the newest picture's time is impossible, compared with all cameras; follows slow changes of delay."""
        most = (now_ns - self._followed_ns) // 10  # delays change slowly; do not follow a clock that runs away
        self._followed_ns = now_ns
        if self._is_off(track):
            track.counts.stray += 1
            track.strays += 1
            track.is_late = True
            return True
        track.strays = 0
        lag = min(track.delay_ns - self._delay_ns, _MAX_PATIENCE * self._deadline_ns)
        track.lag_ns += _SMOOTHING * (lag - track.lag_ns)
        usual = [other.delay_ns for other in self._tracks.values() if other.arrived_ns is not None and not other.strays]
        self._delay_ns += min(max(median_low(usual) - self._delay_ns, -most), most)
        return False

    def _restart_if_all_strayed(self, now_ns: int) -> list[Instant]:
        """Start a new grid when most cameras agree that their common clock was stepped."""
        alive = [t for t in self._tracks.values() if t.state(now_ns, self._lost_ns) is not CameraState.LOST]
        strayed = [track for track in alive if track.strays >= _STRAYS]
        if 2 * len(strayed) <= len(alive):
            return []
        delay = median_low([track.delay_ns for track in strayed])
        agreeing = [track for track in strayed if abs(track.delay_ns - delay) < _AHEAD_NS]
        if 2 * len(agreeing) <= len(alive):
            return []
        ready = self._flush(now_ns)
        self.steps += 1
        self._delay_ns = delay
        elapsed = max(1, round((now_ns - self._closed_ns) / self._period))
        self._lay(self._closed + elapsed, [now_ns - track.delay_ns for track in agreeing])
        return ready

    def _place(self, picture: Picture, now_ns: int) -> None:
        assert self._grid is not None
        track = self._tracks[picture.camera]
        number = self._grid.instant_of(picture.capture_ns)
        if number <= self._closed:
            track.counts.late += 1
            track.is_late = True
            return
        track.is_late = False
        track.turn += _SMOOTHING * (self._grid.turn_of(picture.capture_ns) - track.turn)
        track.counts.skew_ns = round(phase_of(track.turn) * self._period)
        instant = self._open.setdefault(number, _Open(now_ns))
        other = instant.pictures.get(picture.camera)
        if other is not None:
            track.counts.duplicate += 1
            place = self._grid.time_of(number)
            if abs(other.capture_ns - place) <= abs(picture.capture_ns - place):
                return
        instant.pictures[picture.camera] = picture
        track.newest = number if track.newest is None else max(track.newest, number)

    def _close_due(self, now_ns: int) -> list[Instant]:
        """Close instants in order, up to the last one that is complete or past its deadline."""
        if not self._open:
            return []
        alive = self._alive()
        heard = min((-1 if track.newest is None else track.newest for track in alive), default=max(self._open))
        patience = self._patience(alive)
        due = [n for n, instant in self._open.items() if n <= heard or now_ns >= instant.first_ns + patience]
        if not due:
            return []
        last = max(due)
        ready = [self._close(number, now_ns) for number in sorted(self._open) if number <= last]
        ready += self._shift_if_off_centre(alive, now_ns)
        return [instant for instant in ready if instant is not None]

    def _close(self, number: int, now_ns: int) -> Instant | None:
        assert self._grid is not None
        assert self._began_ns is not None
        pictures = self._open.pop(number).pictures
        self._closed, self._closed_ns = number, now_ns
        for name, track in self._tracks.items():
            if name not in pictures:
                track.counts.missing += 1
                track.is_late = True
        gathers = not self._has_given and now_ns - self._began_ns < self._gather_ns
        if len(pictures) < (len(self._tracks) if gathers else self._quorum):
            self.dropped += 1
            return None
        self._has_given = True
        chosen = tuple(pictures.get(name) for name in self._tracks)
        return Instant(number, self._grid.time_of(number), chosen)

    def _flush(self, now_ns: int) -> list[Instant]:
        instants = [self._close(number, now_ns) for number in sorted(self._open)]
        return [instant for instant in instants if instant is not None]

    def _shift_if_off_centre(self, alive: list[CameraTrack], now_ns: int) -> list[Instant]:
        """Move the grid by part of a period when a camera's pictures lie near a boundary and need not.

        Open instants close first, so that every picture stays in the instant nearest to it.
        """
        assert self._grid is not None
        turns = [track.turn for track in alive if abs(track.turn) > _SETTLED]
        if not turns or len(turns) < len(alive):
            return []
        phases = [phase_of(turn) for turn in turns]
        shift = best_phase(phases)
        off = max(abs(phase) for phase in phases)
        moved_off = max(abs(phase - shift - round(phase - shift)) for phase in phases)
        if off < _OFF_CENTRE or moved_off > off - _GAIN:
            return []
        ready = self._flush(now_ns)
        self._grid = replace(self._grid, anchor_ns=self._grid.anchor_ns + round(shift * self._period))
        self.shifts += 1
        for track in alive:
            track.turn = 0
        return ready
