"""Capture clocks and the synchroniser that pairs pictures by time."""
