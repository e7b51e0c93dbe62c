"""Calibration without a board, from features that several cameras see."""
