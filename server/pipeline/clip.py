"""A clip is trained into a file."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from streamlod.codec.container import SlodWriter
from streamlod.core.data import Dataset
from streamlod.core.errors import InputError, StreamlodError, TrainingCutShort
from streamlod.core.files import write_text
from streamlod.core.train import Progress
from streamlod.server.pipeline.sound import AUTO, choose_sound, write_beside
from streamlod.server.pipeline.stages.encoding import EncodedFrame
from streamlod.server.pipeline.stages.opened import OpenJob
from streamlod.server.pipeline.stages.stream import train_stream
from streamlod.server.pipeline.stages.trace import Span


def train_clip(
    opened: OpenJob,
    out: Path,
    on_frame: Callable[[EncodedFrame], None],
    on_progress: Callable[[Progress], None] | None = None,
    sound: str = AUTO,
) -> None:
    """Train a clip into the file `out`, which appears when it is complete; figures go into `out`.json.

    The sound that `sound` names, as in `choose_sound`, goes into `out`.opus. A fault after the first frame, such as a
    damaged picture or a full disk, ends the files there, with all frames trained before.

    Raises:
        TrainingCutShort: such a fault, one that is foreseen; another one is raised as it is, with a note.
    """
    dataset = opened.dataset
    chosen = choose_sound(dataset, sound) if isinstance(dataset, Dataset) else None
    first_seconds, seconds, reports, faults = 0.0, [], [], list[Exception]()
    with SlodWriter(out) as writer, closing(train_stream(opened, on_progress=on_progress)) as frames:
        for encoded in _up_to_fault(frames, faults):
            begin = time.perf_counter()
            try:
                for packet in encoded.packets:
                    writer.append(packet)
            except OSError as error:
                faults.append(InputError(out, f"cannot be written ({error.strerror})"))
                break
            written = Span("write", "write", begin, time.perf_counter())
            reports.append(encoded.report)
            if encoded.version == 0:
                first_seconds = encoded.report["total_seconds"]
            else:
                seconds.append(encoded.report["total_seconds"])
            on_frame(replace(encoded, spans=(*encoded.spans, written)))
        if faults and not reports:
            raise faults[0]
    cut = TrainingCutShort(out, str(faults[0]), len(reports), opened.stop) if faults else None
    figures = {
        "train_seconds": float(np.mean(seconds)) if seconds else None,
        "first_frame_seconds": first_seconds,
        "space": opened.dataset.space.to_json(),
        "trained_cameras": list(dataset.names),
        "job": {name: str(value) for name, value in opened.job.to_json().items()},
        "cut_short": None if cut is None else str(cut),
        "per_frame": reports,
    }
    untold: tuple[type[Exception], ...] = (InputError, OSError) if cut else ()  # what came first is told
    with suppress(*untold):
        write_text(out.with_name(out.name + ".json"), json.dumps(figures, indent=1))
        if isinstance(dataset, Dataset):
            source = dataset.recording.source
            write_beside(out, chosen, source.time_ns(len(reports) - 1) / 1e9 + 1 / source.fps)
    if cut is not None:
        if isinstance(faults[0], StreamlodError | OSError):
            raise cut from faults[0]
        faults[0].add_note(str(cut))
        raise faults[0]


def _up_to_fault(frames: Iterator[EncodedFrame], faults: list[Exception]) -> Iterator[EncodedFrame]:
    """`frames` up to the first error, which is put into `faults`; those of the consumer are its own."""
    try:
        yield from frames
    except Exception as error:
        faults.append(error)
