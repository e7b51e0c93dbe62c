"""The usual engine of later frames: autograd over pictures of which the tiles are drawn that can change."""
