"""Runs of a study, one after another in this process or side by side on a Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Sequence
from typing import Any, Literal, TypeVar

from streamlod.core.errors import BackendUnavailable

T = TypeVar("T")
Jobs = Literal["local", "ray"]
_THREADS = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}  # of a run, which reserves one core


def in_order(
    measure: Callable[..., T], runs: Sequence[tuple[Any, ...]], jobs: Jobs = "local", device: str = "cpu"
) -> Generator[T, None, None]:
    """The results of `measure` for the arguments of each run, in their order.

    On Ray a run takes one core and, unless `device` is "cpu", one GPU where the cluster has any. The cluster is the
    one at RAY_ADDRESS, or of this machine; one of this machine alone is started where there is none.

    Raises:
        BackendUnavailable: Ray is not installed.
    """
    if jobs == "local":
        yield from (measure(*run) for run in runs)
        return
    try:
        import ray
    except ImportError as error:
        raise BackendUnavailable("jobs ray", "install it: pip install 'streamlod[ray]'") from error
    ray.init(log_to_driver=False, logging_level=logging.ERROR, runtime_env={"env_vars": _THREADS})
    try:
        resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
        gpus = 1 if device != "cpu" and resources.get("GPU") else 0
        work = ray.remote(num_cpus=1, num_gpus=gpus)(_call)
        shared = ray.put(measure)
        waiting: list[Any] = [work.remote(shared, *run) for run in runs]
        yield from (ray.get(each) for each in waiting)
    finally:
        ray.shutdown()


def _call(measure: Callable[..., T], *run: Any) -> T:
    return measure(*run)
