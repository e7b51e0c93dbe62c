"""Watching: decode packets, expand them for a viewpoint, splat, and measure.

    connection/     the websocket, with reconnection        playback.py   the protocol without I/O: bytes in, events out
    viewpoints.py   where to look from                      recorder.py   pictures to PNG and MP4
    recording.py    `.slod` files frame by frame            commands.py   `streamlod view | evaluate | info | export`
    rest.py         a server's REST interface               evaluation/   quality, studies and their reports
    web/            the viewer page

Decoding and splatting need numpy and numba alone.
"""
