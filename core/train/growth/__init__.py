"""Where anchors are added and removed."""
