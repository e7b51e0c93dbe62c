"""How fast whole streaming frames are: ``python -m tests.bench.frame_bench [PART ...] [--json FILE] [--svg FILE]``.

A frame is everything from the pictures to the packet: motion, planning, training, rounding, settling and encoding.
The naive step is what training the whole model does: all anchors decoded through autograd, whole pictures,
convolutions, Adam over every parameter. Subjects alternate, on one thread, in CPU time; the clip's frames are timed
on all threads by the wall too, which wants an idle machine. The part ``cuda`` needs a GPU.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import torch

from streamlod.core.errors import BackendUnavailable
from streamlod.core.render import select
from streamlod.core.train import PredictConfig, TrainConfig
from streamlod.core.train.later_frame.parts import USUAL
from tests.bench.frame_gpu import gpu_report
from tests.bench.frame_subjects import Naive, Streaming, make_case, trained_clip
from tests.bench.kernel_time import KernelTime
from tests.bench.parts import parts_parser, run_parts
from tests.threads import MAX_THREADS

EPOCHS = 10
CONFIG = TrainConfig(predict=PredictConfig(epochs=EPOCHS, minimum_steps=0, most_effort=1.0), parts=USUAL)
VGA, HD = (640, 480), (1280, 720)
MOVING = 0.006  # share of the anchors that really move; the partition then trains about 5 %


def measured(work: Callable[[], None], clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of one call."""
    begin = clock()
    work()
    return clock() - begin


def whole(rounds: int = 3) -> dict[str, Any]:
    """A frame against as many naive steps: 200k Gaussians, about 5 % compact dynamic, 5 views of 640x480, 50 steps."""
    case = make_case(20_000, 5, VGA, MOVING)
    streaming, naive = Streaming(case, CONFIG), Naive(case)
    streaming.run()
    naive.step(0)
    ours, theirs = list[float](), list[float]()
    for _ in range(rounds):
        streaming.reset()
        ours.append(measured(streaming.run))
        theirs.append(measured(lambda: naive.run(EPOCHS)))
    found = {"ours s": min(ours), "naive s": min(theirs)}
    found["naive / ours"] = float(np.median(np.array(theirs) / np.array(ours)))
    return {"200k Gaussians": found | describe(streaming)}


def describe(streaming: Streaming) -> dict[str, Any]:
    """Figures of the frame just trained."""
    assert streaming.result is not None
    report = streaming.result.report
    share = report.dynamic / report.anchors
    numbers = {"steps": report.steps, "bytes": len(streaming.packet), "trained": share}
    seconds = report.seconds | {"encode": streaming.encode_seconds}
    return numbers | {f"{stage} wall s": taken for stage, taken in seconds.items()}


def clip(frames: int = 4) -> dict[str, Any]:
    """Frames of the synthetic clip: 480x270, 5 views, 10 epochs, 20k anchors; seconds, and the share of the kernels."""
    trainer, later = trained_clip((480, 270), 5, 20_000, EPOCHS, frames + 1)
    trainer.predict(later[0])
    found: dict[str, Any] = {}
    for threads in (1, MAX_THREADS):
        numba.set_num_threads(threads)
        torch.set_num_threads(threads)
        scene = trainer.scene
        for frame in later[1:]:
            with KernelTime() as kernels, KernelTime(time.perf_counter) as waiting:
                cpu, begin = time.process_time(), time.perf_counter()
                report = trainer.predict(frame).report
                wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
            shares = {f"{name} of cpu": seconds / cpu for name, seconds in kernels.seconds.items()}
            numbers = {
                "wall s": wall,
                "cpu s": cpu,
                "kernels of cpu": kernels.total / cpu,
                "kernels of wall": waiting.total / wall,
                "trained": report.dynamic,
            }
            numbers |= {f"{stage} s": seconds for stage, seconds in report.seconds.items()}
            found[f"{threads} threads, frame {frame.index}"] = numbers | shares
        trainer.resume(scene)
        trainer.predict(later[0])
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    return found


def growth() -> dict[str, Any]:
    """CPU seconds of a frame by views and by anchors, at 320x240 and 4 epochs, and the exponent of a fitted power."""
    config = TrainConfig(predict=PredictConfig(epochs=4, minimum_steps=0, most_effort=1.0), parts=USUAL)

    def seconds(anchors: int, views: int) -> float:
        # in front, where 40,000 anchors hide it no more than 5,000 do
        case = make_case(anchors, views, (320, 240), 0.02, depth=2.2)
        streaming, times = Streaming(case, config), list[float]()
        for _ in range(3):
            streaming.reset()
            times.append(measured(streaming.run))
        return min(times)

    views, anchors = (2, 4, 8), (5_000, 10_000, 20_000, 40_000)
    by_views = {str(n): seconds(10_000, n) for n in views}
    by_anchors = {str(n): seconds(n, 3) for n in anchors}
    return {
        "by views": by_views | {"exponent": _exponent(views, by_views)},
        "by anchors": by_anchors | {"exponent": _exponent(anchors, by_anchors)},
    }


def _exponent(sizes: tuple[int, ...], seconds: dict[str, float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(list(seconds.values())), 1)[0])


def cuda() -> dict[str, Any]:
    """Frames on a GPU: 1280x720, 3 and 5 views, 20k, 60k and 200k anchors; and how their time grows.

    Raises:
        BackendUnavailable: there is no GPU, or gsplat does not work here.
    """
    select("cuda")
    return gpu_report("cuda", CONFIG, (20_000, 60_000, 200_000), (3, 5), HD)


REPORTS: dict[str, Callable[[], dict[str, Any]]] = {"whole": whole, "clip": clip, "growth": growth, "cuda": cuda}


def run(report: Callable[[str], None], wanted: list[str] | None = None) -> dict[str, Any]:
    """Measure the `wanted` parts, or all that can work here; report each line as it comes; return every number."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    for name in wanted or REPORTS:
        report(name)
        try:
            found[name] = REPORTS[name]()
        except BackendUnavailable as error:
            if wanted:
                raise
            found[name] = {"skipped": {"because": str(error)}}
        for case, numbers in found[name].items():
            texts = [f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in numbers.items()]
            report(f"  {case}: {', '.join(texts)}")
    return found


def main() -> None:
    """The command line."""
    parser = parts_parser(__doc__, REPORTS)
    options = parser.parse_args()
    run_parts(parser, options, REPORTS, run, ("A streaming frame", "seconds of CPU"))


if __name__ == "__main__":
    main()
