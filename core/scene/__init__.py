"""The integer state of a scene: anchors, octree, residuals, and how they expand to Gaussians."""
