"""Finds what moves: pixels first, then anchors."""
