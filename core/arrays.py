"""Array types, the check of shape and type that constructors make, and the nearest of sorted values."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int16 = NDArray[np.int16]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]


def check_array(name: str, array: NDArray[Any], shape: tuple[int | None, ...], dtype: DTypeLike) -> None:
    """Raise for an array of another shape or type; ``None`` in `shape` stands for any length.

    Raises:
        TypeError: not an array, or another dtype.
        ValueError: another shape.
    """
    if not isinstance(array, np.ndarray) or array.dtype != np.dtype(dtype):
        found = array.dtype if isinstance(array, np.ndarray) else f"a {type(array).__name__}"
        raise TypeError(f"{name} must be an array of {np.dtype(dtype)}, not {found}")
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = "x".join("N" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} must have shape {wanted}, not {'x'.join(map(str, array.shape)) or 'scalar'}")


def nearest_of(among: Float64, times: Float64) -> Int64:
    """[N] places in `among` [K], ascending and not empty, of the nearest to each of `times` [N]; of two, the first."""
    after = np.minimum(np.searchsorted(among, times), len(among) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(among[before] - times) <= np.abs(among[after] - times)
    return np.where(closer, before, after).astype(np.int64)
