"""Tokens, keys and signed links."""
