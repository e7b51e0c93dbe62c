"""Engines that train later frames."""
