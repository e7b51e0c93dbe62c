"""Measurements of one scene: quality, bytes, memory, motion."""
