"""Films of what a viewpoint sees of a live stream."""
