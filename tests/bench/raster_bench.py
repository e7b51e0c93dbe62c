"""How fast the CPU rasteriser and loss are: ``python -m tests.bench.raster_bench [PART ...]``, with --json and --svg.

Subjects alternate within every round, so that both meet the same neighbours. Times are of the process's CPU on one
thread unless said otherwise.

The part ``cuda`` needs a GPU: wall times of the CUDA backend, and pictures a second with levels and decoding.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from streamlod.core.errors import BackendUnavailable
from streamlod.core.render import rasterise, select
from streamlod.core.render.cpu.frame import backward, forward
from streamlod.core.render.cpu.workspace import Workspace
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.autograd.tile_cache import TileCache, make_tile_cache
from streamlod.core.train.loss.photometric import photometric_loss
from tests.bench.parts import parts_parser, run_parts
from tests.bench.raster_gpu import gpu_report
from tests.bench.raster_subjects import NAMES, convolution_loss, make_scene, tensors, torch_tiles
from tests.threads import MAX_THREADS

Subjects = dict[str, Callable[[], object]]
BACKGROUND = np.array([0.1, 0.2, 0.3], np.float32)
VGA, HD = (640, 480), (1280, 720)


def alternate(
    subjects: Subjects, rounds: int = 7, clock: Callable[[], float] = time.process_time
) -> dict[str, list[float]]:
    """Milliseconds of each subject, one a round; the first round only warms up."""
    times: dict[str, list[float]] = {name: [] for name in subjects}
    for _ in range(rounds + 1):
        for name, work in subjects.items():
            begin = clock()
            work()
            times[name].append(1e3 * (clock() - begin))
    return {name: values[1:] for name, values in times.items()}


def ratios(subjects: Subjects, base: str, rounds: int = 7) -> dict[str, float]:
    """Least milliseconds of each subject, and the median over rounds of its ratio to `base`."""
    times = alternate(subjects, rounds)
    found = {f"{name} ms": min(values) for name, values in times.items()}
    for name, values in times.items():
        if name != base:
            found[f"{name} / {base}"] = float(np.median(np.array(values) / np.array(times[base])))
    return found


def kernel_step(count: int, size: tuple[int, int]) -> Callable[[], object]:
    """Forward and backward of our kernels, projection and sorting included."""
    cloud, camera = make_scene(count, *size)
    workspace, upstream = Workspace(), np.random.default_rng(0).normal(size=(size[1], size[0], 3)).astype(np.float32)
    return lambda: backward(workspace, forward(workspace, cloud, camera, BACKGROUND), cloud, upstream)


def against_torch() -> dict[str, Any]:
    """Ours against a plain torch tile rasteriser and the dense reference, all through autograd."""
    background, found = torch.from_numpy(BACKGROUND), {}
    for count, size, subject in ((10_000, (320, 240), "torch tiles"), (1_000, (96, 64), "dense reference")):
        cloud, camera = make_scene(count, *size)

        def ours(cloud: GaussianCloud = cloud, camera: Any = camera) -> None:
            rasterise(*tensors(cloud), camera, background).image.square().mean().backward()

        def tiles(cloud: GaussianCloud = cloud, camera: Any = camera) -> None:
            torch_tiles(tensors(cloud), camera, background).square().mean().backward()

        def dense(cloud: GaussianCloud = cloud, camera: Any = camera) -> None:
            rasterise(*tensors(cloud), camera, background, backend="reference").image.square().mean().backward()

        other = tiles if subject == "torch tiles" else dense
        found[f"{count} at {size[0]}x{size[1]}"] = ratios({"ours": ours, subject: other}, "ours", rounds=3)
    return found


def loss() -> dict[str, Any]:
    """Fused loss against grouped convolutions, forward and backward."""
    found = {}
    for width, height in (VGA, HD):
        image, target = torch.rand(height, width, 3, requires_grad=True), torch.rand(height, width, 3)
        subjects: Subjects = {
            "fused": lambda image=image, target=target: photometric_loss(image, target).backward(),
            "convolutions": lambda image=image, target=target: convolution_loss(image, target).backward(),
        }
        found[f"{width}x{height}"] = ratios(subjects, "fused", rounds=5)
    return found


def dirty(count: int = 200_000) -> dict[str, Any]:
    """Render, loss and gradients of a step on dirty tiles against full pictures with all gradients and either loss."""
    cloud, camera = make_scene(count, *VGA)
    background, target = torch.from_numpy(BACKGROUND), torch.rand(VGA[1], VGA[0], 3)
    middle = np.linalg.inv(camera.world_to_camera)[:3] @ np.array([0, 0, 5, 1])
    by_distance = np.argsort(np.linalg.norm(cloud.means - middle, axis=1))
    orders = {"compact": by_distance, "scattered": np.random.default_rng(0).permutation(count)}
    found = {}
    for layout, order in orders.items():
        for share in (0.01, 0.05, 0.2, 1.0):
            moving = int(count * share)
            dynamic, static = (
                GaussianCloud(*(np.ascontiguousarray(getattr(cloud, n)[rows]) for n in NAMES))
                for rows in (order[:moving], order[moving:])
            )
            others = tensors(static, gradients=False)
            base = rasterise(*tensors(cloud, gradients=False), camera, background).image
            cache = make_tile_cache(camera, _splats(dynamic), _splats(static), background, "cpu", base=base)

            def whole(loss: Any, dynamic: GaussianCloud = dynamic, others: Any = others) -> None:
                joined = [torch.cat(pair) for pair in zip(tensors(dynamic), others, strict=True)]
                loss(rasterise(*joined, camera, background).image, target).backward()

            def part(dynamic: GaussianCloud = dynamic, cache: TileCache = cache) -> None:
                image = cache.render(_splats(dynamic, gradients=True)).image
                photometric_loss(image, target, region=cache.region).backward()

            subjects: Subjects = {
                "dirty": part,
                "full": lambda whole=whole: whole(photometric_loss),
                "full, convolutions": lambda whole=whole: whole(convolution_loss),
            }
            assert cache.backdrop is not None
            tiles, still = float(cache.backdrop.tile_mask.mean()), len(cache.backdrop.records)
            numbers = {"tiles dirty": tiles, "static needed": still / max(1, len(static))}
            found[f"{layout} {share:.0%}"] = numbers | ratios(subjects, "dirty", rounds=3)
    return found


def _splats(cloud: GaussianCloud, *, gradients: bool = False) -> Splats:
    return Splats(*tensors(cloud, gradients))


def threads() -> dict[str, Any]:
    """One thread and all: wall time, CPU time, and how evenly the tiles' work is shared."""
    most, found = MAX_THREADS, {}
    for count in (50_000, 200_000):
        step, result = kernel_step(count, VGA), {}
        for number in (1, most):
            numba.set_num_threads(number)
            result[f"{number} wall ms"] = min(alternate({"step": step}, clock=time.perf_counter)["step"])
            result[f"{number} cpu ms"] = min(alternate({"step": step})["step"])
        cloud, camera = make_scene(count, *VGA)
        frame = forward(Workspace(), cloud, camera, BACKGROUND)
        pairs = np.concatenate([[0], np.cumsum(np.diff(frame.offsets)[frame.tiles])])
        result["largest share of pairs"] = float(np.diff(pairs[frame.bounds]).max() / pairs[-1])
        result["speed-up"] = result["1 wall ms"] / result[f"{most} wall ms"]
        numba.set_num_threads(1)
        found[str(count)] = result
    return found


def growth() -> dict[str, Any]:
    """Milliseconds by number of Gaussians and by pixels, and the exponent of a fitted power."""
    counts, sizes = (10_000, 20_000, 50_000, 100_000, 200_000, 400_000), ((320, 240), VGA, (960, 720), (1280, 960))
    by_count = {str(n): min(alternate({"": kernel_step(n, VGA)}, 3)[""]) for n in counts}
    by_size = {f"{w}x{h}": min(alternate({"": kernel_step(50_000, (w, h))}, 3)[""]) for w, h in sizes}

    def exponent(x: Any, y: Any) -> float:
        return float(np.polyfit(np.log(x), np.log(list(y)), 1)[0])

    pixels = [w * h for w, h in sizes]
    return {
        "by Gaussians": by_count | {"exponent": exponent(counts, by_count.values())},
        "by pixels": by_size | {"exponent": exponent(pixels, by_size.values())},
    }


def memory() -> dict[str, Any]:
    """Growth of the process's peak memory by one step at 200k Gaussians and 1280x720, in a process of its own."""
    answer = subprocess.run(
        [sys.executable, "-m", __spec__.name, "--memory"], check=True, capture_output=True, text=True
    )
    return dict(json.loads(answer.stdout))


def measure_memory() -> dict[str, Any]:
    """What `memory` runs: kernels and scene loaded first, so that only the step is counted."""
    kernel_step(1000, VGA)()
    workspace = Workspace()
    cloud, camera = make_scene(200_000, *HD)
    upstream = np.ones((HD[1], HD[0], 3), np.float32)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew (Linux)
    before = _peak_kib()
    gradients = backward(workspace, forward(workspace, cloud, camera, BACKGROUND), cloud, upstream)
    grown = {"step MiB": (_peak_kib() - before) / 1024, "workspace MiB": workspace.size_bytes / 2**20}
    return grown | {"visible": len(gradients.rows)}


def cuda() -> dict[str, Any]:
    """The CUDA backend at 1280x720.

    Raises:
        BackendUnavailable: there is no GPU, or gsplat does not work here.
    """
    select("cuda")
    return gpu_report("cuda", (50_000, 200_000), (20_000, 60_000, 200_000), HD)


def _peak_kib() -> int:
    return int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1])  # type: ignore[index]


REPORTS: dict[str, Callable[[], dict[str, Any]]] = {
    "against torch": against_torch,
    "loss": loss,
    "dirty tiles": dirty,
    "threads": threads,
    "growth": growth,
    "memory": memory,
    "cuda": cuda,
}


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
            found[name] = {"skipped": str(error)}
        for case, numbers in found[name].items():
            shown = numbers if isinstance(numbers, dict) else {"": numbers}
            texts = [f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in shown.items()]
            report(f"  {case}: {', '.join(texts)}")
    return found


def main() -> None:
    """The command line."""
    parser = parts_parser(__doc__, REPORTS)
    parser.add_argument("--memory", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.memory:
        print(json.dumps(measure_memory()))
        return
    run_parts(parser, options, REPORTS, run, ("Forward and backward", "milliseconds of CPU"))


if __name__ == "__main__":
    main()
