"""Streams out of plain Gaussians: what other programs wrote, as `.slod` files.

field.py     Gaussians to integer states, one an anchor
stream.py    files, or a sequence of them, to packets
"""

from streamlod.codec.imported.stream import import_files, is_importable

__all__ = ["import_files", "is_importable"]
