"""What moves: pixels first, then anchors."""
