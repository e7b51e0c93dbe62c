"""Keyframes in mid-stream, which go on from the state of the stream."""
