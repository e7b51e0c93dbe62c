"""COLMAP reconstructions, text and binary."""
