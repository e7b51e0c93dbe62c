"""`streamlod doctor`: what this machine can do, checked by doing it."""
