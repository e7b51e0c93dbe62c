"""The process that makes a stream's packets, by training or from a recorded file. It reports to its supervisor by pipe.

A message is one byte, its `Tag`, and a body. No other part of the server runs in this process, so a crash, a memory
leak or a kill costs viewers only a short pause.
"""

from __future__ import annotations

import importlib
import json
import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from enum import IntEnum
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamlod.core.background_log import log_in_background
from streamlod.core.errors import BackendUnavailable, BitstreamError, InputError, StreamlodError
from streamlod.core.gaps import MAX_GAP_SECONDS
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker.camera_pictures import CameraPictures
from streamlod.server.worker.progress_report import ProgressReport

if TYPE_CHECKING:
    from streamlod.core.scene.anchors import Scene
    from streamlod.server.pipeline.stages.encoding import EncodedFrame
    from streamlod.server.pipeline.stages.opened import OpenJob

_LOG = logging.getLogger(__name__)
HEARTBEAT_SECONDS = 1.0
_INGEST_SECONDS = 0.5
_BEHIND_SECONDS = 2.0  # that playing a file may be late and still catch up
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_NICENESS = 5  # of training: serving has priority, and so has publishing the last state again
_LOADING_NICENESS = 19  # of loading code into a spare worker


class Tag(IntEnum):
    """First byte of a message."""

    PACKET = 1  # the packet
    PREVIEW = 2  # an early keyframe, shown but not recorded
    REPORT = 3  # JSON: figures of a finished frame
    PROGRESS = 4  # JSON: fraction, loss, text; or null
    FAILURE = 5  # JSON: text, fatal, and refused, a `Shortage`, where there was no room for it
    EPOCH = 6  # empty: versions begin anew
    END = 7  # empty: the source has no more frames
    HEARTBEAT = 8  # resident memory in bytes, as 8 bytes
    INGEST = 9  # JSON: figures of live cameras, and whether training waits for them
    PICTURES = 10  # of `camera_pictures`
    PLACED = 11  # JSON: node of the cluster that the worker runs on
    SOUND = 12  # a piece of live sound, of `codec.mp4.sound`
    MICROPHONE = 13  # JSON: camera at which live sound is heard, or null; comes before sound


@dataclass(frozen=True, slots=True)
class Resume:
    """Where a restarted worker continues.

    Attributes:
        packets: a keyframe and, where it is older than the state, the residual that leads there.
        frames: number of frames of the source that are done.
    """

    packets: tuple[bytes, ...] = ()
    frames: int = 0


def send_resume(resume: Resume, pipe: Connection) -> None:
    """Tell a worker where to continue; blocks until it listens."""
    pipe.send_bytes(json.dumps({"frames": resume.frames, "packets": len(resume.packets)}).encode())
    for packet in resume.packets:
        pipe.send_bytes(packet)


def receive_resume(pipe: Connection) -> Resume:
    """The state that `send_resume` sent."""
    told = json.loads(pipe.recv_bytes())
    return Resume(tuple(pipe.recv_bytes() for _ in range(told["packets"])), told["frames"])


class Sender:
    """Messages to the supervisor, from several threads."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self._lock = pipe, threading.Lock()

    def send(self, tag: Tag, body: bytes | dict[str, Any] = b"") -> None:
        """Send one message; blocks while the supervisor is behind."""
        data = body if isinstance(body, bytes) else json.dumps(_plain(body)).encode()
        with self._lock:
            self._pipe.send_bytes(bytes((tag,)) + data)


def run_worker(
    spec: StreamSpec,
    pipe: Connection,
    push_socket: Path | None = None,
    spare: bool = False,
    camera_pictures: bool = False,
) -> None:
    """Entry of the process; returns when the source ends, and never raises.

    Args:
        pipe: to the supervisor, which first sends where to continue.
        push_socket: where to take pictures that capture nodes push to the serving process.
        spare: load everything before it is needed.
        camera_pictures: also send small pictures of what the cameras see.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the supervisor decides
    log_in_background()
    sender = Sender(pipe)
    try:
        loading = None
        if spare and spec.job is not None:
            loading = threading.Thread(target=_load, args=(spec.job,), daemon=True, name="loading")
            loading.start()
        resume = receive_resume(pipe)
        threading.Thread(target=_beat, args=(sender,), daemon=True, name="heartbeat").start()
        if spec.job is None:
            play(spec, resume, sender)
        else:
            scene = show_again(resume, sender) if resume.packets else None
            os.nice(_NICENESS)
            if loading is not None:
                loading.join()
            train(spec.job, scene, resume.frames, sender, push_socket, camera_pictures)
        sender.send(Tag.END)
    except StreamlodError as error:
        sender.send(Tag.FAILURE, {"text": str(error), "fatal": _is_fatal(error, spec)})
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the supervisor is gone
    except Exception as error:
        _LOG.exception("worker of stream %s", spec.id)
        sender.send(Tag.FAILURE, {"text": f"{type(error).__name__}: {error}", "fatal": False})


def _is_fatal(error: StreamlodError, spec: StreamSpec) -> bool:
    """Whether another try cannot help: unusable input stays as it is, and so does a file that is played."""
    return isinstance(error, InputError | BackendUnavailable) or (
        spec.play is not None and isinstance(error, BitstreamError)
    )


def _load(job: TrainJob) -> None:
    """Load the code for publishing the last state, then for training, at low priority."""
    from streamlod.server.pipeline.warming import warm_codec

    os.nice(_NICENESS)
    try:
        warm_codec()
        # this is most of the work, and starts no threads, which would keep the low priority
        importing = threading.Thread(target=_import_training, daemon=True, name="importing")
        importing.start()
        importing.join()
        from streamlod.server.pipeline.rehearsal import rehearse

        rehearse(job.preset, job.device)
    except Exception:  # whatever is wrong, training meets it too and reports it
        _LOG.warning("a spare worker could not rehearse", exc_info=True)


def _import_training() -> None:
    if sys.platform == "linux":  # elsewhere the niceness would apply to the whole process and could not be taken back
        os.nice(_LOADING_NICENESS)
    importlib.import_module("streamlod.server.pipeline.stages.stream")


def train(
    job: TrainJob,
    scene: Scene | None,
    start: int,
    sender: Sender,
    push_socket: Path | None = None,
    camera_pictures: bool = False,
) -> None:
    """Train the source's frames as they come and send their packets, and figures and pictures of cameras.

    Args:
        scene: the keyframe to continue from, which has been sent; None to train one.
        start: first frame to read.
    """
    if job.frames is not None and start >= job.frames:
        return
    from streamlod.codec.mp4.sound import SoundPiece, pack_piece
    from streamlod.server.pipeline.stages.opened import open_job
    from streamlod.server.pipeline.stages.stream import train_stream

    def give_sound(piece: SoundPiece) -> None:
        with suppress(ConnectionError):  # the server has gone, which ends this process elsewhere
            sender.send(Tag.SOUND, pack_piece(piece))

    report = ProgressReport(partial(sender.send, Tag.PROGRESS))
    with report.compiling():
        opened, pictures = open_job(job, push_socket, give_sound), None
        if scene is not None:  # here, as the figures that are told below are of the rig that is read
            opened = opened.continuing(scene)
        if job.live is not None:
            sender.send(Tag.MICROPHONE, {"camera": opened.microphone})
        if camera_pictures:
            pictures = CameraPictures(opened.dataset.upright)
            opened = replace(opened, on_read=pictures.note)
        frames = train_stream(opened, resume=scene, start=start, previews=True, on_progress=report.trained)
        with closing(frames), _told(opened, pictures, sender):
            for encoded in frames:
                for packet in encoded.packets:
                    sender.send(Tag.PREVIEW if encoded.preview else Tag.PACKET, packet)
                if not encoded.preview:
                    sender.send(Tag.REPORT, encoded.report | {"stages": _stages(encoded)})


def _stages(encoded: EncodedFrame) -> list[tuple[str, int, int]]:
    """When the stages of a frame ran: name, begin and end in Unix ns.

    Reading live cameras is mostly waiting for the next instant; in its place stands the time since it was filmed.
    """
    behind_ns = time.time_ns() - time.perf_counter_ns()
    spans = [(span.name, span.begin, span.end) for span in encoded.spans]
    if (latency := encoded.report.get("latency_seconds")) is not None:
        spans[0] = "ingest", spans[-1][2] - latency, spans[0][2]
    return [(name, int(begin * 1e9) + behind_ns, int(end * 1e9) + behind_ns) for name, begin, end in spans]


@contextmanager
def _told(opened: OpenJob, pictures: CameraPictures | None, sender: Sender) -> Iterator[None]:
    """Report the figures of live cameras twice a second, and their pictures, while the context lasts."""
    over = threading.Event()

    def run() -> None:
        with suppress(ConnectionError):  # the server has gone, which ends this process elsewhere
            while not over.wait(_INGEST_SECONDS):
                statistics = opened.statistics()
                if statistics is not None:
                    sender.send(Tag.INGEST, asdict(statistics))
                if pictures is not None and (body := pictures.take()) is not None:
                    sender.send(Tag.PICTURES, body)

    thread = threading.Thread(target=run, name="ingest statistics", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def play(spec: StreamSpec, resume: Resume, sender: Sender) -> None:
    """Send the packets of a recorded file at the pace at which they were filmed."""
    from streamlod.codec.packet.packet import PacketKind
    from streamlod.server.pipeline.recorded import streamed_packets, whole_packets

    assert spec.play is not None
    state, entries = _file_state(spec.play), streamed_packets(spec.play)
    start, damaged = 0, set[int]()
    if resume.frames:
        done = min(resume.frames, len(entries)) - 1
        start = max(n for n in range(done + 1) if entries[n][1].kind is PacketKind.KEY)
    while True:
        begin = time.monotonic() - entries[start][1].time_ns / 1e9
        for number, info, data in whole_packets(spec.play, entries, damaged):
            if number < start:
                continue
            wait = begin + info.time_ns / 1e9 - time.monotonic()
            if wait < -_BEHIND_SECONDS:  # nobody watched, and it had to wait: go on from here
                begin -= wait
            begin -= max(0.0, wait - MAX_GAP_SECONDS)  # nobody waits while nothing was filmed
            time.sleep(min(max(0.0, wait), MAX_GAP_SECONDS))
            sender.send(Tag.PACKET, data)
            sender.send(Tag.REPORT, {"version": info.to_version, "done": number + 1})
        if not spec.loop:
            return
        time.sleep(_frame_seconds(entries))
        sender.send(Tag.EPOCH)
        start = 0
        if (now := _file_state(spec.play)) != state:  # somebody has put another one in its place
            state, entries, damaged = now, streamed_packets(spec.play), set()


def _file_state(path: Path) -> tuple[int, int] | None:
    """Time and size of a file, which change with its content; None where there is no such file."""
    with suppress(OSError):
        found = path.stat()
        return found.st_mtime_ns, found.st_size
    return None


def _frame_seconds(entries: Sequence[tuple[int, Any]]) -> float:
    """Pause between the last frame and the first one of the next round."""
    first, last = entries[0][1], entries[-1][1]
    frames = last.to_version - first.to_version
    return float(min(1.0, max(0.01, (last.time_ns - first.time_ns) / 1e9 / frames))) if frames else 1.0


def show_again(resume: Resume, sender: Sender) -> Scene:
    """Publish the state to continue from as a keyframe, before anything slow is loaded or a camera is opened."""
    from streamlod.codec.decoder import SceneDecoder
    from streamlod.codec.encoder import encode_keyframe
    from streamlod.codec.packet.info import peek
    from streamlod.core.scene.keyframe import as_keyframe

    decoder = SceneDecoder()
    for packet in resume.packets:
        decoder.push(packet)
    assert decoder.scene is not None
    scene = as_keyframe(decoder.scene, decoder.scene.version + 1)
    sender.send(Tag.PACKET, encode_keyframe(scene, time_ns=peek(resume.packets[-1]).time_ns))
    sender.send(Tag.REPORT, {"version": scene.version, "done": resume.frames, "resumed": True})
    return scene


def _plain(value: Any) -> Any:
    """`value` as JSON has it: plain numbers, and none that are not finite."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    return float(value) if math.isfinite(float(value)) else None


def resident_bytes(pid: int | None) -> int:
    """Resident memory of a process of this machine; 0 where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_BYTES
    except (OSError, IndexError, ValueError):
        return 0


def _beat(sender: Sender) -> None:
    try:
        while True:
            sender.send(Tag.HEARTBEAT, resident_bytes(os.getpid()).to_bytes(8))
            time.sleep(HEARTBEAT_SECONDS)
    except OSError:
        os._exit(1)  # the supervisor is gone; nobody needs this process
