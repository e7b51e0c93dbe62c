"""The server's fixtures, for attacks on it."""

from tests.server.conftest import clip

__all__ = ["clip"]
