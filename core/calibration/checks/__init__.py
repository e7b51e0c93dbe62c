"""Checks of a rig before it films: clocks, focus, exposure, how the space is covered, and whether the poses hold."""
