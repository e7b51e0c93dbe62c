"""The command line of a benchmark that has several parts."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from streamlod.core.errors import BackendUnavailable
from tests.bench.growth_plot import growth_plot


def parts_parser(description: str | None, parts: Iterable[str]) -> argparse.ArgumentParser:
    """Options that all such benchmarks have."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("parts", nargs="*", help=f"of: {', '.join(parts)}; all by default")
    parser.add_argument("--json", type=Path, help="write every number to this file")
    parser.add_argument("--svg", type=Path, help="draw the part growth to this file")
    return parser


def run_parts(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    parts: Iterable[str],
    run: Callable[[Callable[[str], None], Sequence[str]], dict[str, Any]],
    growth: tuple[str, str],
) -> None:
    """Run what was asked for and write what it found.

    Args:
        parts: all there are. growth: title of the plot, and label of its axis.
    """
    if set(options.parts) - set(parts):
        parser.error(f"parts are: {', '.join(parts)}")
    try:
        found = run(print, options.parts)
    except BackendUnavailable as error:
        sys.exit(str(error))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    if options.svg and "growth" in found:
        options.svg.write_text(growth_plot(*growth, found["growth"]))
