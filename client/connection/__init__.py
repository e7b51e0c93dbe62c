"""Connections to the servers of a stream."""
