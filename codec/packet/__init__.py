"""Packets: kinds, header, directory and what may stand in them."""
