"""Capture nodes that push pictures to the server."""
