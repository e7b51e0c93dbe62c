"""Trains a stream's source and sends its packets, figures and pictures to the supervisor."""

from __future__ import annotations

import importlib
import logging
import os
import sys
import threading
import time
from contextlib import closing, suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from streamlod.core.repeating import repeating
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.worker.camera_pictures import CameraPictures
from streamlod.server.worker.messages import Resume, Sender, Tag
from streamlod.server.worker.progress_report import ProgressReport

if TYPE_CHECKING:
    from streamlod.core.scene.anchors import Scene
    from streamlod.server.pipeline.stages.encoding import EncodedFrame
    from streamlod.server.pipeline.stages.opened import OpenJob

_LOG = logging.getLogger(__name__)
_INGEST_SECONDS = 0.5
NICENESS = 5  # of training: serving has priority, and so has publishing the last state again
_LOADING_NICENESS = 19  # of loading code into a spare worker


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
        telling = repeating(partial(tell, opened, pictures, sender), _INGEST_SECONDS, "ingest statistics")
        with closing(frames), telling:
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


def tell(opened: OpenJob, pictures: CameraPictures | None, sender: Sender) -> None:
    """Send the figures of live cameras, and their pictures."""
    with suppress(ConnectionError):  # the server has gone, which ends this process elsewhere
        if (statistics := opened.statistics()) is not None:
            sender.send(Tag.INGEST, asdict(statistics))
        if pictures is not None and (body := pictures.take()) is not None:
            sender.send(Tag.PICTURES, body)


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


def load(job: TrainJob) -> None:
    """Load the code for publishing the last state, then for training, at low priority."""
    from streamlod.server.pipeline.warming import warm_codec

    os.nice(NICENESS)
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
