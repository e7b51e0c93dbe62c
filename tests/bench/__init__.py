"""Benchmarks. Importing `core` first sets what torch and numba read when they load."""

import streamlod.core  # noqa: F401
