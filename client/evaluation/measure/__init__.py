"""What is measured of one scene: quality, bytes, memory, motion."""
