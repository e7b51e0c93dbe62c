"""A small JPEG file of a picture, for people who want to see what a camera sees."""

from __future__ import annotations

from streamlod.core.arrays import UInt8

MAX_SIDE = 320  # pixels
_QUALITY = 70  # of JPEG


def small_jpeg(image: UInt8) -> bytes:
    """An image [H,W,3] RGB with its longer side shrunk to `MAX_SIDE`."""
    import cv2

    scale = min(1.0, MAX_SIDE / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
