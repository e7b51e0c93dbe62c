"""Training of the first frame, and of any keyframe."""
