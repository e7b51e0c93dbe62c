"""Draw a recording from a moving viewpoint: python examples/draw_orbit.py scene.slod orbit.mp4"""

from __future__ import annotations

import sys
from itertools import count

from streamlod import Splatter, open_recorder, open_recording, orbit


def main(path: str, out: str) -> None:
    recording = open_recording(path)
    header = recording.scene(recording.versions[0]).header
    splatter, viewpoint = Splatter(), orbit(header, pictures=90)
    with open_recorder(out, fps=header.fps) as film:
        for number, frame in zip(count(), recording.frames(), strict=False):
            film.add(splatter.picture(frame.scene, viewpoint(number)))
        print(f"{film.count} pictures in {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
