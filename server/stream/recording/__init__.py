"""Recordings: files of streams on disk."""
