"""Programs of others with our MP4 files: mp4box.js, which comes from npm."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from streamlod.codec.container import SlodReader
from streamlod.codec.mp4 import Mp4Reader, write_mp4
from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import write_sound
from streamlod.codec.sound.packets import read_packets
from tests.clicks import clicks
from tests.server.conftest import make_clip

MP4BOX = "mp4box@2.4.1"
TOOL = Path(__file__).with_name("mp4_tools.mjs")


@pytest.mark.slow
def test_mp4box_reads_writes_and_cuts_what_we_read_again(tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("no npm here")
    clip = make_clip(tmp_path / "clip.slod", 30, (4, 8), 10, 40_000_000)
    write_sound(sound_beside(clip.path), [clicks(1.2)], 1, 0)
    write_mp4(clip.path, tmp_path / "clip.mp4")
    subprocess.run(["npm", "install", "--silent", "--no-save", MP4BOX], cwd=tmp_path, check=True)
    shutil.copy(TOOL, tmp_path)
    command = ["node", TOOL.name, "clip.mp4", "again.mp4", "cut.mp4"]
    told = json.loads(subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout)
    settings, sound = read_packets(sound_beside(clip.path))
    assert told[0] == {"codec": "slp1", "samples": 30, "sync": [0, 400_000, 800_000]}
    assert (told[1]["codec"], told[1]["samples"]) == ("Opus", len(sound))
    with SlodReader(clip.path) as reader:
        whole = list(reader.packets())
    for name in ("again", "cut"):
        with Mp4Reader(tmp_path / f"{name}.mp4") as mp4:
            assert list(mp4.packets()) == whole
            assert (mp4.sound, list(mp4.sound_packets())) == (settings, sound)
