"""Cameras: the geometry of one (`camera`), and the space in which a rig of them is trained (`space`)."""

from streamlod.core.camera.camera import Camera, look_at, pinhole

__all__ = ["Camera", "look_at", "pinhole"]
