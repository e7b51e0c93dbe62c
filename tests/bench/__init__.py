"""Benchmarks. Importing `core` first sets what torch and numba read when they load."""

import core  # noqa: F401
