"""Streams over HTTP for other programs: playlists of HLS and segments of MP4. codec/FORMAT.md section 19.

numbers.py   numbers of segments
parts.py     segments and parts out of retained packets
routes.py    addresses
"""
