"""The loss of first and later frames."""
