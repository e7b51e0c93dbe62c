"""Answers of the server: REST, the live websocket, health."""
