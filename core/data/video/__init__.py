"""Video files: their pictures, upright and with their times, and the instants at which a rig's files were filmed."""

from streamlod.core.data.video.file import SUFFIXES, VideoInfo, probe_video, read_video

__all__ = ["SUFFIXES", "VideoInfo", "probe_video", "read_video"]
