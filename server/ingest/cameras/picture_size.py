"""The size of a camera's pictures: that for which it is calibrated, and no other."""

from __future__ import annotations

from streamlod.core.errors import InputError


def check_size(camera: str, found: tuple[int, int], size: tuple[int, int]) -> None:
    """Refuse pictures of another (width, height) than `size`.

    Raises:
        InputError: they have another one.
    """
    if found != size:
        fault = f"delivers {found[0]}x{found[1]}, but is calibrated for {size[0]}x{size[1]}"
        raise InputError(f"camera {camera}", fault)


def max_pixels(size: tuple[int, int]) -> int:
    """Largest picture that a decoder may allocate for a camera of (width, height): padded to whole blocks."""
    return (size[0] + 64) * (size[1] + 64)
