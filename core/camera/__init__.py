"""Cameras: the geometry of one (`camera`), the space in which a rig is trained (`space`), its
instants (`grid`), and views as the page writes them (`view`).
"""

from streamlod.core.camera.camera import Camera, look_at, pinhole

__all__ = ["Camera", "look_at", "pinhole"]
