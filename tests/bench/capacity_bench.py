"""Capacity: what so many viewers of so many streams take, from measured figures, and whether a simulation agrees.

    streamlod bench capacity [--viewers 1000000 --streams 100 --kbps 1000 --regions 0.4,0.35,0.25]
                             [--figures FILE] [--simulate] [--edge-hour 0.5 --gpu-hour 2 --gigabyte 0.01 ...]

FILE is what `streamlod bench crowd --json FILE` wrote: of it the bytes per CPU-second at the largest number of viewers
that was held are taken. Every other figure is an option too; `capacity_model` says what each means. `--simulate` places
every single viewer, loses the largest region and prints what it counted beside what the model says.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from pathlib import Path

from streamlod.core.errors import InputError
from tests.bench.capacity_model import Demand, Figures, Plan, plan
from tests.bench.capacity_simulation import Outcome, simulate


def measured(path: Path) -> dict[str, float]:
    """Figures from a file of `streamlod bench crowd`.

    Raises:
        InputError: it holds none.
    """
    try:
        held = [row for row in json.loads(path.read_text())["rows"] if row["held"]]
        return {"bytes_per_cpu_second": float(held[-1]["bytes_per_cpu_second"])}
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(path, "holds no number of viewers that was held; write it with bench crowd --json") from error


def describe(demand: Demand, figures: Figures, planned: Plan) -> list[str]:
    """The plan as lines."""
    regions = " + ".join(map(str, planned.edges))
    return [
        f"{demand.viewers} viewers of {demand.streams} streams of {demand.kbps:g} kbit/s",
        f"an edge: {figures.edge_bytes / 1e6:.0f} MB/s at most, {planned.viewers_per_edge:.0f} viewers",
        f"edges: {regions} in {planned.machines} machines of {figures.cores} cores and {figures.gigabits:g} Gbit/s",
        f"load: {planned.load:.0%}, {planned.load_after:.0%} in the worst region when the largest is lost",
        f"from the origin: {planned.origin_bytes * 8 / 1e9:.1f} Gbit/s, "
        f"{planned.parent_bytes * 8 / 1e9:.2f} with one edge a region between",
        f"to viewers: {demand.viewers * demand.stream_bytes * 8 / 1e9:.0f} Gbit/s",
        f"lost region: {planned.lost_viewers} viewers have pictures {planned.recovery_seconds:.1f} s after they come",
        f"GPUs: {planned.gpus}",
        f"NATS: {planned.storage_bytes / 1e9:.0f} GB on {figures.replicas} servers, "
        f"{demand.streams * demand.stream_bytes / 1e6:.1f} MB/s written on each",
        f"cost of an hour: {planned.hour:.2f}",
    ]


def compare(planned: Plan, seen: Outcome) -> list[str]:
    """Model and simulation, a line each."""
    rows: tuple[tuple[str, float, float], ...] = (
        ("from the origin [Gbit/s]", planned.origin_bytes * 8e-9, seen.origin_bytes * 8e-9),
        ("with one edge a region between [Gbit/s]", planned.parent_bytes * 8e-9, seen.parent_bytes * 8e-9),
        ("load of an edge", planned.load, seen.load),
        ("load after the loss, worst region", planned.load_after, seen.load_after),
        ("pictures again [s], of 99 %", planned.recovery_seconds, seen.recovery_seconds),
    )
    lines = [f"{name}: model {model:.3f}, simulation {found:.3f}" for name, model, found in rows]
    return [
        *lines,
        f"fullest edge: {seen.worst_load:.0%}, after the loss {seen.worst_load_after:.0%}; "
        f"the last viewer has a picture after {seen.last_seconds:.1f} s",
    ]


def main() -> None:
    """Print the plan, and the simulation if it is wanted."""
    parser = argparse.ArgumentParser(prog="streamlod bench capacity")
    parser.add_argument("--figures", type=Path)
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--json", type=Path)
    for name in ("--viewers", "--streams", "--cores", "--replicas"):
        parser.add_argument(name, type=int)
    for name in ("--kbps", "--popularity", "--retention-seconds", "--bytes-per-cpu-second", "--join-bytes",
                 "--gpus-per-stream", "--gigabits", "--use", "--edge-hour", "--gpu-hour", "--gigabyte",
                 "--gigabyte-month"):  # fmt: skip
        parser.add_argument(name, type=float)
    parser.add_argument("--regions", type=lambda text: tuple(map(float, text.split(","))))
    options = vars(parser.parse_args())
    known = {} if options["figures"] is None else measured(options["figures"])
    known |= {name: value for name, value in options.items() if value is not None}
    demand = Demand(**{each.name: known[each.name] for each in fields(Demand) if each.name in known})
    figures = Figures(**{each.name: known[each.name] for each in fields(Figures) if each.name in known})
    try:
        planned = plan(demand, figures)
    except ValueError as error:
        raise InputError("--regions", str(error)) from error
    print("\n".join(describe(demand, figures, planned)))
    if options["simulate"]:
        print("\n".join(compare(planned, simulate(demand, figures, planned))))
    if options["json"] is not None:
        options["json"].write_text(
            json.dumps({each.name: getattr(planned, each.name) for each in fields(Plan)}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
