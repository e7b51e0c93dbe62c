"""Entropy coding: rANS, the models of what is coded, and the slow reference."""
