"""Optimiser, losses, rate term, schedules and convergence."""
