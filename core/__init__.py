"""Scenes of level-of-detail neural Gaussians: cameras, anchors, rendering, training.

The ground floor (this package's own modules) needs numpy alone; `core.render`, `core.train`, `core.initialise` and
`core.data` need the training libraries. Nothing here imports `codec`, `server` or `client`.
"""

from streamlod.core.runtime import prepare_environment

prepare_environment()
