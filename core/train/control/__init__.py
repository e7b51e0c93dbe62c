"""Budgets of time and bytes for later frames."""
