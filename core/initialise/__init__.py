"""First points of a scene: where the octree of the first frame begins.

`first_points` chooses: the data set's own points, a plane sweep with the known poses (`sweep`, checked across views by
`consistency`), depth of a VGGT model placed into the known cameras (`vggt`), a file of points (`points_file`), or, as
a last resort, random points in the common view volume (`scatter`).
"""

from core.initialise.first import METHODS, first_points
from core.initialise.points_file import read_points

__all__ = ["METHODS", "first_points", "read_points"]
