"""Whole streaming frames on a GPU: seconds by stage, pictures a second, and growth, as ``frame_bench cuda`` tells.

The device is an argument, so that the benchmark itself is tested where there is no GPU.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from streamlod.core.render import select
from streamlod.core.train import TrainConfig
from tests.bench.frame_subjects import Streaming, make_case
from tests.bench.raster_gpu import finish

_MOVING = 0.006  # share of the anchors that really move; about 5 % are then trained
_ROUNDS = 3
_PICTURES = 100
_DEPTH = 2.2  # of what moves: in front, where no number of anchors hides it


def gpu_report(
    device: str,
    config: TrainConfig,
    anchors: tuple[int, ...],
    views: tuple[int, ...],
    size: tuple[int, int],
    moving: float = _MOVING,
) -> dict[str, Any]:
    """Figures of every number of anchors with every number of views, then growth about the smallest of them.

    Args:
        moving: share of the anchors that really move.
    """
    found = {
        f"{count} anchors, {cameras} views": frame_figures(device, config, count, cameras, size, moving)
        for cameras in views
        for count in anchors
    }
    few, least = min(anchors), min(views)
    half = (size[0] // 2, size[1] // 2)

    def seconds(pixels: tuple[int, int], share: float) -> float:
        return float(frame_figures(device, config, few, least, pixels, share, pictures=0)["wall s"])

    by_anchors = {str(n): found[f"{n} anchors, {least} views"]["wall s"] for n in anchors}
    by_views = {str(n): found[f"{few} anchors, {n} views"]["wall s"] for n in views}
    by_pixels = {f"{w}x{h}": seconds((w, h), moving) for w, h in (half, size)}
    by_share = {str(share): seconds(size, share) for share in (moving, 2 * moving, 8 * moving)}
    found["growth with anchors"] = _fitted(by_anchors, float)
    found["growth with views"] = _fitted(by_views, float)
    found["growth with pixels"] = _fitted(by_pixels, lambda name: float(np.prod([int(n) for n in name.split("x")])))
    found["growth with the moving share"] = _fitted(by_share, float)
    return found


def frame_figures(
    device: str,
    config: TrainConfig,
    anchors: int,
    views: int,
    size: tuple[int, int],
    moving: float,
    pictures: int = _PICTURES,
) -> dict[str, Any]:
    """Wall seconds of a frame (the best of some), of its stages, and pictures a second with levels and decoding."""
    streaming = Streaming(make_case(anchors, views, size, moving, select(device), _DEPTH), config, device)
    streaming.run()  # kernels load, memory is reserved
    best: dict[str, Any] = {"wall s": float("inf")}
    for _ in range(_ROUNDS):
        streaming.reset()
        finish(device)
        begin = time.perf_counter()
        streaming.run()
        finish(device)
        wall = time.perf_counter() - begin
        if wall < best["wall s"]:
            assert streaming.result is not None
            report = streaming.result.report
            best = {"wall s": wall, "steps": report.steps, "bytes": len(streaming.packet)}
            best["trained"] = report.dynamic / report.anchors
            stages = report.seconds | {"encode": streaming.encode_seconds}
            best |= {f"{stage} s": seconds for stage, seconds in stages.items()}
    if pictures:
        streaming.draw(3)
        begin = time.perf_counter()
        streaming.draw(pictures)
        best["pictures a second"] = pictures / (time.perf_counter() - begin)
    if device == "cuda":
        best["memory MiB"] = torch.cuda.max_memory_allocated() / 2**20
        torch.cuda.reset_peak_memory_stats()
    return best


def _fitted(times: dict[str, float], number: Callable[[str], float]) -> dict[str, Any]:
    sizes = np.log([number(name) for name in times])
    exponent = np.polyfit(sizes, np.log(list(times.values())), 1)[0] if len(times) > 1 else float("nan")
    return {**times, "exponent": float(exponent)}
