"""Chunks of a packet: a level's geometry, parameters and changes as bytes."""
