"""The preset `paper`, and what only it needs."""
