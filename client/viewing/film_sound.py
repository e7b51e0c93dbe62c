"""The sound of a recorded film: what was heard when its pictures were filmed, put into the MP4 beside them."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path
from urllib.parse import unquote

import av
import av.audio.stream
import av.container
import numpy as np

from streamlod.codec.sound.beside import look_at_sound
from streamlod.codec.sound.opus import LAYOUTS, SAMPLE_RATE, audio_frame
from streamlod.core.arrays import Int16
from streamlod.core.data.video.sound import filmed_sound
from streamlod.core.errors import InputError, RequestRefused
from streamlod.core.files import temporary_beside, written_whole

_log = logging.getLogger(__name__)
_ADDRESS = re.compile(r"(?P<scheme>wss?)(?P<place>://.+)/v1/streams/(?P<stream>[^/?#]+)/live")
_LAST_NS = 2_000_000_000  # that the last picture is shown at most
_TOLERANCE_NS = 40_000_000  # that sound may be off the pictures before it is joined anew


def fetch_and_add(url: str, token: str | None, film: Path, filmed_ns: Sequence[int | None], fps: float) -> None:
    """Put the sound of the stream at `url` into its film; where that fails, the film stays silent and it is logged.

    Args:
        url: live websocket of the stream.
        token: bearer token, where the server wants one.
        film: an MP4 without sound.
        filmed_ns: when each of its pictures was filmed, on the clock of the packets; None for silence.
        fps: pictures a second of the film.
    """
    from streamlod.client.rest import ServerClient

    address = _ADDRESS.fullmatch(url)
    if address is None:
        return
    sound = temporary_beside(film.with_suffix(".opus"))
    server = f"{address['scheme'].replace('ws', 'http')}{address['place']}"
    try:
        with ServerClient(server, token) as client:
            times = [time for time in filmed_ns if time is not None]
            last_ns = None if not times else max(times) + _LAST_NS
            client.download_sound(unquote(address["stream"]), sound, max(0, min(times, default=0)), last_ns)
        add_sound(film, sound, filmed_ns, fps)
    except (InputError, RequestRefused) as error:
        _log.warning("%s has no sound: %s", film, error)
    finally:
        sound.unlink(missing_ok=True)


def add_sound(film: Path, sound: Path, filmed_ns: Sequence[int | None], fps: float) -> None:
    """Put the Ogg Opus file `sound` into the MP4 `film`, as AAC; arguments are those of `fetch_and_add`.

    Raises:
        InputError: the sound cannot be read, or the film cannot be written; it stays as it was.
    """
    facts = look_at_sound(sound)
    blocks = chain.from_iterable(
        _heard(sound, None if begin is None else begin - facts.begin_ns, count, facts.channels)
        for begin, count in _runs(filmed_ns, fps)
    )
    try:
        with (
            written_whole(film) as temporary,
            closing(av.open(str(film))) as silent,
            closing(av.open(str(temporary), "w", format="mp4", options={"movflags": "faststart"})) as container,
        ):
            pictures = container.add_stream_from_template(silent.streams.video[0])
            track = container.add_stream("aac", rate=SAMPLE_RATE)
            track.layout = LAYOUTS[facts.channels]
            at = 0
            for packet in silent.demux(silent.streams.video[0]):
                if packet.dts is None or packet.time_base is None:  # the end
                    continue
                until, packet.stream = packet.dts * packet.time_base, pictures
                container.mux(packet)
                while at < until * SAMPLE_RATE and (block := next(blocks, None)) is not None:
                    at = _encode(container, track, block, at)
            for block in blocks:
                at = _encode(container, track, block, at)
            container.mux(track.encode(None))
    except (av.FFmpegError, OSError) as error:
        raise InputError(film, f"cannot be written with sound ({error.strerror})") from error


def _encode(container: av.container.OutputContainer, track: av.audio.stream.AudioStream, block: Int16, at: int) -> int:
    """Append a block whose first sample has the number `at`; returns the number after its last."""
    container.mux(track.encode(audio_frame(block, at)))
    return at + len(block)


def _runs(filmed_ns: Sequence[int | None], fps: float) -> Iterator[tuple[int | None, int]]:
    """Parts of the film during which its pictures were filmed at its own pace: their first time, and samples."""
    ends = [round(number * SAMPLE_RATE / fps) for number in range(len(filmed_ns) + 1)]
    first = 0
    for number, time_ns in enumerate(filmed_ns):
        begin = filmed_ns[first]
        if begin is None or time_ns is None:
            goes_on = begin is time_ns
        else:
            goes_on = abs(time_ns - begin - (number - first) * 1e9 / fps) <= _TOLERANCE_NS
        if not goes_on:
            yield begin, ends[number] - ends[first]
            first = number
    if filmed_ns:
        yield filmed_ns[first], ends[-1] - ends[first]


def _heard(sound: Path, begin_ns: int | None, count: int, channels: int) -> Iterator[Int16]:
    """`count` samples of the file from a time on, in blocks; silence for None."""
    if begin_ns is None:
        yield np.zeros((count, channels), np.int16)
    else:
        yield from filmed_sound(sound, SAMPLE_RATE, begin_ns, count)
