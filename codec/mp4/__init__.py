"""Packets in MP4 files (ISO BMFF, ISO/IEC 14496-12) and HLS playlists (RFC 8216). FORMAT.md section 19.

box.py       boxes to bytes and back
samples.py   packets to samples, one an instant
segment.py   the beginning of a file, and its fragments
file.py      a whole file, and groups of pictures as segments
tables.py    where samples lie, as tables of a file say
reader.py    packets and sound of a file
playlist.py  HLS playlists
sound.py     pieces of live sound
"""

from streamlod.codec.mp4.file import write_hls, write_mp4, write_slod
from streamlod.codec.mp4.reader import Mp4Reader

__all__ = ["Mp4Reader", "write_hls", "write_mp4", "write_slod"]
