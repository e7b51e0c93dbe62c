"""First points of a scene: where the octree of the first frame begins.

`first_points` applies one of `methods`: the data set's own points, a plane sweep with the known poses, a large network
of an optional package, or, as a last resort, random points. A method is a function (`method`); a new one is a module in
`methods` that names it. A file of points (`points_file`) will do as well.
"""

from streamlod.core.initialise.first import METHODS, first_points
from streamlod.core.initialise.points_file import read_points

__all__ = ["METHODS", "first_points", "read_points"]
