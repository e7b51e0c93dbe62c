"""`python -m tests.fuzz.run_bounded TARGET [--seconds 60] [--seed 1]`: mutants under limits of memory and time.

Needs no fuzzer. Targets are those of `targets` and of `server_targets`. An input that takes more than a second of
processor time, or more memory than there is left, fails; it is written to ``tests/fuzz/found``. Who stops it early is
told how many there were. Target `differential`
gives each mutant to the Python decoder and to the page's, which runs under node, and compares refusals and states;
`rust` does the same with the decoder in Rust, for `--count` mutants if that is given.
The page's own targets are in `run_page.mjs`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import signal
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import FrameType

from streamlod.codec.decoder import SceneDecoder
from streamlod.core.errors import BitstreamError
from streamlod.server.pipeline.warming import warm_codec
from tests.codec import rust
from tests.fuzz import server_targets
from tests.fuzz.corpus import KEPT, SEEDS, mutants
from tests.fuzz.targets import REPAIRS, TARGETS, repair
from tests.vectors.make import FOLDER, read_stream, state_of

_MEMORY = 1 << 30  # bytes beside what the process has taken
_INPUT_SECONDS = 1.0  # of processor time
_BATCH = 500  # mutants for one run of node
_NODE = Path(__file__).with_name("decode_all.mjs")


def main() -> None:
    """Run one target for so long; print how many executions there were."""
    parser = argparse.ArgumentParser(description="Fuzz under limits of memory and time.")
    parser.add_argument("target", choices=[*sorted(TARGETS), *sorted(server_targets.TARGETS), *_OTHERS])
    parser.add_argument("--seconds", type=float, default=60.0, help="of processor time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, help="end after so many mutants, of differential and rust")
    options = parser.parse_args()
    begin, counted = _processor_seconds(), 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as a hand at the keyboard stops it
    if options.target in _OTHERS:
        seconds = math.inf if options.count else options.seconds
        counts = differential(_OTHERS[options.target], seconds, options.seed, options.count or math.inf)
    else:
        counts = _alone(options.target, options.seconds, options.seed)
    with suppress(KeyboardInterrupt):
        for count in counts:
            counted = count
    told = f"{counted} executions in {_processor_seconds() - begin:.0f} s of processor time, no finding"
    sys.stdout.write(f"{options.target}, seed {options.seed}: {told}\n")


def _alone(name: str, seconds: float, seed: int) -> Iterator[int]:
    """Mutants for one target for so long; the number of executions so far, after each."""
    if name in TARGETS:
        seeds, target = SEEDS[name](), TARGETS[name]
    else:
        seeds, target = list(server_targets.SEEDS[name]), server_targets.TARGETS[name]
    fix = REPAIRS.get(name, lambda data: data)
    warm_codec()
    for data in seeds:
        target(data)
    _limit_memory()
    signal.signal(signal.SIGVTALRM, _too_slow)
    end = _processor_seconds() + seconds
    for count, data in enumerate(mutants(seeds, 1 << 40, seed)):
        _within_limits(target, data if count % 16 == 0 else fix(data))
        yield count + 1
        if _processor_seconds() > end:
            return


def _processor_seconds() -> float:
    """Processor seconds of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def _within_limits(target: Callable[[bytes], None], data: bytes) -> None:
    signal.setitimer(signal.ITIMER_VIRTUAL, _INPUT_SECONDS)
    try:
        target(data)
    except KeyboardInterrupt:
        raise
    except BaseException:
        (KEPT / f"finding-{len(list(KEPT.iterdir()))}.bin").write_bytes(data)
        raise
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)


def _too_slow(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"an input takes more than {_INPUT_SECONDS} s")


def _limit_memory() -> None:
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + _MEMORY, taken + _MEMORY))


Chosen = list[tuple[bytes, bytes]]  # last packet of a stream, and its mutant
Before = dict[bytes, list[bytes]]  # the packets before it


def differential(
    other: Callable[[Chosen, Before], list[list[object]]], seconds: float, seed: int, most: float
) -> Iterator[int]:
    """Mutants of the last packet of each stream for Python's and another decoder; the number so far, after each batch.

    Args:
        seconds: of processor time, after which it ends. most: mutants, after which it ends.
    """
    streams = [read_stream(path) for path in sorted(FOLDER.glob("*.slps"))]
    lasts = [stream[-1] for stream in streams if len(stream[-1]) < 20_000]
    before = {stream[-1]: stream[:-1] for stream in streams}
    ready = {last: _decoded(before[last]) for last in lasts}
    count, batches = 0, mutants([struct.pack("<I", n) + last for n, last in enumerate(lasts)], 1 << 40, seed)
    end = _processor_seconds() + seconds
    while _processor_seconds() < end and count < most:
        chosen: Chosen = []
        for data in islice(batches, _BATCH):
            number = struct.unpack("<I", data[:4].ljust(4, b"\0"))[0]
            chosen.append((lasts[number % len(lasts)], repair(data[4:])))
        ours = [_outcome(ready[last], mutant) for last, mutant in chosen]
        for one, its, (last, mutant) in zip(ours, other(chosen, before), chosen, strict=True):
            if one != its:
                (KEPT / f"differential-{count}.bin").write_bytes(mutant)
                raise AssertionError(f"after {len(before[last])} packets: Python says {one}, the other {its}")
        count += len(chosen)
        yield count


def _decoded(packets: list[bytes]) -> SceneDecoder:
    decoder = SceneDecoder()
    for packet in packets:
        decoder.push(packet)
    return decoder


def _outcome(ready: SceneDecoder, packet: bytes) -> list[object]:
    """The refusal code, or the state after the packet."""
    decoder = SceneDecoder()
    decoder.__dict__.update(ready.__dict__)
    try:
        decoder.push(packet)
    except BitstreamError as error:
        return [error.code]
    state = state_of(decoder)
    return ["", state["versions"], state["levels"]]


def _by_node(chosen: Chosen, before: Before) -> list[list[object]]:
    """What the page's decoder makes of each mutant after the packets before it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutants.bin"
        with path.open("wb") as file:
            for last, mutant in chosen:
                packets = [*before[last], mutant]
                file.write(struct.pack("<I", len(packets)))
                for packet in packets:
                    file.write(struct.pack("<I", len(packet)) + packet)
        done = subprocess.run(["node", str(_NODE), str(path)], capture_output=True, text=True, check=False, timeout=300)
    if done.returncode:
        raise AssertionError(done.stderr[-2000:])
    found: list[list[object]] = json.loads(done.stdout)
    return found


def by_rust(chosen: Chosen, before: Before) -> list[list[object]]:
    """What the decoder in Rust makes of each mutant after the packets before it."""
    program = rust.program()
    found = rust.outcomes(program, [[*before[last], mutant] for last, mutant in chosen], program.with_name("mutants"))
    return [[code] if code else ["", state["versions"], state["levels"]] for code, state in found]


_OTHERS = {"differential": _by_node, "rust": by_rust}


if __name__ == "__main__":
    sys.exit(main())
