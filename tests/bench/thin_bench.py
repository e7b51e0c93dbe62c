"""What a viewer costs for which the server draws: processor time and bytes a picture, by size and grade.

python -m tests.bench.thin_bench --anchors 20000
"""

from __future__ import annotations

import argparse
import time

from streamlod.core.render.splatter import Splatter
from streamlod.server.viewer.grades import GRADES
from streamlod.server.viewer.renderer import PictureRenderer
from tests.client.web.scenes import make_scene, moved

_REPEATS = 5


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anchors", type=int, default=20_000, help="about so many, four Gaussians each")
    scene = make_scene(parser.parse_args().anchors, view_dependent=False)
    renderer, splatter, camera = PictureRenderer(1, 2**25), Splatter(), scene.header.cameras[0]
    print(f"{scene.anchor_count} anchors, {len(splatter.cloud(scene, camera))} Gaussians drawn")
    print("| size | grade | CPU ms, the same scene | CPU ms, a new frame | KB |\n| --- | --- | --- | --- | --- |")
    for width, height in ((640, 360), (1280, 720)):
        view = camera.scaled(width, height)
        for grade in GRADES:
            renderer.render_picture(splatter, scene, view, 16, grade)
            begin = time.process_time()
            for _ in range(_REPEATS):
                rendered = renderer.render_picture(splatter, scene, view, 16, grade)
            still = time.process_time() - begin
            frames = [scene := moved(scene) for _ in range(_REPEATS)]
            begin = time.process_time()
            for frame in frames:
                renderer.render_picture(splatter, frame, view, 16, grade)
            moving = time.process_time() - begin
            cells = (
                f"{width}x{height}",
                f"{grade.scale:g}, JPEG {grade.quality}",
                f"{1000 * still / _REPEATS:.1f}",
                f"{1000 * moving / _REPEATS:.1f}",
                f"{len(rendered.jpeg) / 1000:.1f}",
            )
            print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
