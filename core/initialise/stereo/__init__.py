"""Depth of every view from the pictures of others: a plane sweep, and slanted windows that begin with it."""
