"""Streams of another server, pulled once and served on."""
