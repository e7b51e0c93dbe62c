"""Watching: decode packets, expand them for a viewpoint, splat, and measure.

    connection.py   the websocket, with reconnection       playback.py   the protocol without it: bytes in, events out
    splat.py        a scene and a camera to a picture       viewpoints.py where to look from
    recording.py    `.slod` files frame by frame            record.py     pictures to PNG and MP4
    commands.py     what `streamlod view | evaluate | info | export` do
    web/            the viewer page

Decoding and splatting need numpy and numba alone.
"""
