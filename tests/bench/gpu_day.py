"""`python -m tests.bench.gpu_day`: all that a GPU has to show, in one program.

Run it first on the day that a GPU is there. Every part writes its figures to a JSON file as it ends, and is passed over
when the program is run again with that file, unless it failed. What it measures itself comes first; the programs that
it starts in the end (tests, sanitizer) are stopped after four minutes each. `--device cpu --small` tries the program
itself where there is no GPU.

Parts: the device; correctness (a step against the CPU's); steps launched and replayed, stage by stage, with memory;
whole pictures drawn; the rasterisers; whole later frames by both engines; the tests that want a GPU; compute-sanitizer.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
import warp as wp

from streamlod.core.render import Backend
from streamlod.core.render.backends import cuda_fault, warp_fault
from streamlod.core.train.engine.warp.room import view_of
from streamlod.core.train.engine.warp.step import TrainingStep
from tests.bench.gpu_frames import frame_figures
from tests.bench.raster_gpu import step_times
from tests.bench.step_subject import Sizes, make_step, told, work

TESTS = ("tests/core/render", "tests/core/train/engine/warp", "tests/core/train/test_cuda.py")
STEPS = 60
MAX_SECONDS = 240  # of another program
SMALL = Sizes(anchors=300, moving=40, slots=4, width=96, height=54, cameras=3)
Figures = dict[str, Any]


def main() -> None:
    """Run the parts that are not done yet, then print everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help=f"of: {', '.join(PARTS)}; all by default")
    parser.add_argument("--json", type=Path, default=Path("gpu_day.json"), help="figures of the parts that are done")
    parser.add_argument("--device", default="cuda", help="cuda, or cpu to try the program")
    parser.add_argument("--small", action="store_true", help="a tiny scene, to try the program")
    given = parser.parse_args()
    if unknown := set(given.parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}")
    if given.device == "cuda" and (missing := warp_fault()) is not None:
        sys.exit(f"{missing}: try the program with --device cpu --small")
    sizes = SMALL if given.small else Sizes()
    found: Figures = json.loads(given.json.read_text()) if given.json.exists() else {}
    for name in given.parts or PARTS:
        if name in found and not given.parts and "failed" not in found[name]:
            continue
        begin = time.perf_counter()
        try:
            found[name] = PARTS[name](given.device, sizes)
        except Exception as fault:  # whatever it is: a minute of a GPU is dear, and other parts may work
            traceback.print_exc()
            found[name] = {"failed": f"{type(fault).__name__}: {fault}"}
        found[name]["seconds"] = round(time.perf_counter() - begin, 1)
        given.json.write_text(json.dumps(found, indent=1))
        print(table(name, found[name]), flush=True)


def table(name: str, figures: Figures) -> str:
    """One part's figures in Markdown."""
    shown = {key: f"{value:.4g}" if isinstance(value, float) else value for key, value in figures.items()}
    rows = (f"| {key} | {value} |" for key, value in shown.items())
    return "\n".join([f"\n| {name} | |", "| --- | --- |", *rows])


def device_part(device: str, _sizes: Sizes) -> Figures:
    """What the figures were measured on."""
    found: Figures = {"date": time.strftime("%Y-%m-%d"), "warp": wp.config.version, "torch": torch.__version__}
    if device == "cuda":
        here = wp.get_device("cuda")
        found |= {"device": here.name, "architecture": here.arch, "multiprocessors": here.sm_count}
        found["driver"] = _said("nvidia-smi", "--query-gpu=driver_version,clocks.max.sm,power.limit", "--format=csv")
    return found


def correctness(device: str, _sizes: Sizes) -> Figures:
    """Steps on the device, the first launched and the others replayed, against the CPU's."""
    few = replace(SMALL, views=2)
    here, there = make_step(few, "cpu"), make_step(few, device)
    for number in range(3):
        for step in (here, there):
            step.run(number, told(number, few.width * few.height), (0, 2))
    found: Figures = {}
    for name in ("losses", "values", "first"):
        one, other = (view_of(getattr(step.room.trained, name)).cpu() for step in (here, there))
        found[f"{name}, relative difference from the CPU"] = float((other - one).norm() / one.norm().clamp_min(1e-30))
    found["overflow"] = there.room.moving.overflow
    return found


def gpu_tests(device: str, _sizes: Sizes) -> Figures:
    """The tests that want a GPU; all others need none."""
    if device != "cuda":
        return {"tests on the GPU": "not here"}
    command = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "cuda", *TESTS)
    return {"tests on the GPU": _said(*command)}


def sanitizer(device: str, _sizes: Sizes) -> Figures:
    """NVIDIA's compute-sanitizer over small steps: bounds, what was never written, and lanes that do not meet."""
    program = shutil.which("compute-sanitizer", path=f"{os.environ['PATH']}:/usr/local/cuda/bin")
    if device != "cuda" or program is None:
        return {"compute-sanitizer": "not here"}
    found: Figures = {}
    with tempfile.TemporaryDirectory() as folder:
        command = ["-m", "tests.bench.gpu_day", "steps", "--small", "--json", f"{folder}/figures.json"]
        for tool in ("memcheck", "initcheck", "synccheck"):  # kernels have no shared memory for racecheck
            found[tool] = _said(program, "--tool", tool, sys.executable, *command)
    return found


def steps_part(device: str, sizes: Sizes) -> Figures:
    """Milliseconds of a step launched kernel by kernel and replayed, of its stages, and memory."""
    before = _free(device)
    step = make_step(sizes, device)
    pixels = sizes.width * sizes.height
    found: Figures = {**asdict(sizes), "MiB taken": (before - _free(device)) / 2**20}

    def chosen(number: int) -> tuple[int, ...]:
        return tuple((number + view) % sizes.cameras for view in range(sizes.views))

    def run(number: int) -> None:
        step.run(number, told(number, pixels), chosen(number))

    def launch(number: int) -> None:
        step.tell(number, told(number, pixels), chosen(number))
        step.launch()

    run(0)
    found |= work(step.room)
    found["ms, launched"] = _milliseconds(device, launch)
    found["ms, replayed"] = _milliseconds(device, run)
    found["ms of the host, replayed"] = _host_milliseconds(device, run)
    found |= _stages(device, step)
    found["overflow"] = step.room.moving.overflow
    return found


def all_views(device: str, sizes: Sizes) -> Figures:
    """As `steps`, every view of the rig in one step."""
    return steps_part(device, replace(sizes, views=sizes.cameras))


def drawing(device: str, sizes: Sizes) -> Figures:
    """Whole pictures a second of all anchors, every tile drawn, nothing learnt."""
    step = make_step(replace(sizes, anchors=max(sizes.anchors // 5, sizes.moving + 1)), device)
    step.tell(0, told(0, sizes.width * sizes.height), tuple(range(sizes.views)))
    view_of(step.room.sight.dirty).fill_(1)
    each = _milliseconds(device, lambda _: step.show())
    return {"Gaussians": step.room.still_count.numpy()[0].item(), "pictures a second": 1e3 * sizes.views / each}


def rasterisers(device: str, sizes: Sizes) -> Figures:
    """Whole pictures with gradients, by the rasteriser of the device and by Warp's behind the same interface."""
    backends: list[Backend] = ["warp"]
    if device == "cpu" or cuda_fault() is None:  # gsplat may not be here
        backends.insert(0, "cpu" if device == "cpu" else "cuda")
    size, count = (sizes.width, sizes.height), 300 if sizes == SMALL else 50_000
    rounds = 2 if sizes == SMALL else 20
    return {
        f"{backend}, {name}": spent
        for backend in backends
        for name, spent in step_times(device, backend, count, size, rounds).items()
    }


def frames(device: str, sizes: Sizes) -> Figures:
    """Whole later frames, by autograd over the rasteriser of the device and by recorded steps."""
    return frame_figures(device, sizes.width, sizes.height, sizes.cameras, 40 if sizes == SMALL else 600)


PARTS: dict[str, Callable[[str, Sizes], Figures]] = {
    "device": device_part,
    "correctness": correctness,
    "steps": steps_part,
    "all views": all_views,
    "drawing": drawing,
    "rasterisers": rasterisers,
    "frames": frames,
    "tests": gpu_tests,
    "sanitizer": sanitizer,
}


def _milliseconds(device: str, run: Callable[[int], None]) -> float:
    """Milliseconds of a step, the mean over a frame's worth of them, after some to warm up; waits at the end only."""
    for number in range(3):
        run(number)
    wp.synchronize_device(device)
    begin = time.perf_counter()
    for number in range(STEPS):
        run(number)
    wp.synchronize_device(device)
    return 1e3 * (time.perf_counter() - begin) / STEPS


def _host_milliseconds(device: str, run: Callable[[int], None]) -> float:
    """Milliseconds that the host is busy with a step, with the device idle before and nobody waiting for it."""
    wp.synchronize_device(device)
    begin = time.perf_counter()
    for number in range(STEPS):
        run(number)
    spent = time.perf_counter() - begin
    wp.synchronize_device(device)
    return 1e3 * spent / STEPS


def _stages(device: str, step: TrainingStep) -> Figures:
    """Milliseconds of the four stages, each repeated by itself, so that launches cost what they cost eagerly."""
    stages = {"show": step.show, "judge": step.judge, "pull": step.pull, "update": step.update}
    return {f"ms, {name} launched": _milliseconds(device, lambda _, f=run: f()) for name, run in stages.items()}  # type: ignore[misc]


def _free(device: str) -> int:
    return int(wp.get_device(device).free_memory) if device == "cuda" else 0


def _said(*command: str) -> str:
    """The last line that a program wrote, or why there is none."""
    with tempfile.TemporaryFile("w+") as out:
        try:
            done = subprocess.run(command, stdout=out, stderr=subprocess.STDOUT, check=False, timeout=MAX_SECONDS)
            ended = f"exit code {done.returncode}"
        except OSError as fault:
            return f"{type(fault).__name__}: {fault}"
        except subprocess.TimeoutExpired:
            ended = f"stopped after {MAX_SECONDS} s"
        out.seek(0)
        last = [line.strip() for line in out if line.strip()][-1:]
    return ", ".join([*last, *([] if last and ended == "exit code 0" else [ended])])


if __name__ == "__main__":
    main()
