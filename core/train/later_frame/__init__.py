"""Training of a later frame: integer residuals of what changes."""
