"""Optimiser, losses, rate term, and schedules."""
