"""First frame where viewers stand: at every camera that trains, beside each, and at the held-out one, against plain.

    python -m tests.bench.fit_at_cameras DATA [--downscale 2 --preset live --frame 0 --seeds 1 --plain]
    python -m tests.bench.fit_at_cameras wide:room[:20] (four cameras 50 or 20 degrees apart round a synthetic place)

Without `--test` all cameras train. Prints PSNR as shown, at the best exposure, and SSIM at each place; beside the
cameras only for synthetic data, of which it is known what is seen there. `--plain` trains plain Gaussians on the same
points for the same CPU seconds. Of ours, also what each level and those coarser than it are worth at the cameras, and
their bytes. `--set opacity_weight=0` and the like change one choice; `--out DIR` saves pictures
with the truth on the left, at the cameras and, of synthetic data, beside them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from streamlod.client.evaluation.measure.places import BESIDE, places, places_table, true_view
from streamlod.client.evaluation.measure.scores import Perception, draw, score_picture
from streamlod.client.evaluation.report.output import result_folder, side_by_side
from streamlod.client.recorder import write_png
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.camera.beside import views_beside
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.data import linspace_split, open_dataset
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr
from streamlod.core.scene.anchors import Scene, empty_level
from streamlod.core.synthetic import SyntheticSpec, read_spec, render_view
from streamlod.core.train import TrainConfig, Trainer, preset
from tests.bench.zoo.plain import PlainGaussians, plain_views

_PLACES = (-1.5, -0.5, 0.5, 1.5)  # of the wide rig round what it looks at, in steps
_RADIUS, _FOCAL, _HEIGHT = 2.5, 0.6, (1.75, 1.25)


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """One instant: what trains, where it starts, and what measures.

    Attributes:
        cameras, frame: that train. points: first ones.
        held_out: (camera, picture) pairs. spec: of a synthetic place, else None; `space` leads from it to the cameras'.
    """

    cameras: tuple[Camera, ...]
    frame: FrameSet
    points: PointCloud
    held_out: list[tuple[Camera, UInt8]]
    spec: SyntheticSpec | None
    space: Similarity
    fps: float


def changed(config: TrainConfig, settings: list[str]) -> TrainConfig:
    """`config` with each ``field=number`` of `settings` applied to its model or keyframe part."""
    model, keyframe = config.model, config.keyframe
    for name, text in (setting.split("=") for setting in settings):
        value = text == "true" if text in ("true", "false") else float(text)
        if name in {field.name for field in fields(model)}:
            model = replace(model, **{name: type(getattr(model, name))(value)})
        else:
            keyframe = replace(keyframe, **{name: type(getattr(keyframe, name))(value)})
    return replace(config, model=model, keyframe=keyframe)


def recorded(data: Path, downscale: float, index: int, views: int | None, test: tuple[str, ...]) -> Subject:
    """A frame of a recording, or of a synthetic clip in files."""
    dataset = open_dataset(data, downscale=downscale)
    names = list(dataset.names)
    rows = [names.index(name) for name in linspace_split(names, views, test).train]
    frame = next(iter(dataset.frames(index, index + 1)))
    cameras = tuple(dataset.cameras[row] for row in rows)
    training = FrameSet(frame.index, frame.time_ns, frame.images[rows], frame.present[rows])
    points = first_points(training, cameras, depth_bounds=dataset.depth_bounds, dataset_points=dataset.points())
    held_out = [(dataset.cameras[names.index(name)], frame.images[names.index(name)]) for name in test]
    return Subject(cameras, training, points, held_out, read_spec(data), dataset.space, dataset.fps)


def wide(kind: str, downscale: float, apart: float = 50.0) -> Subject:
    """Four cameras, `apart` degrees one from the next, round the target of a synthetic place, as phones round a person.

    They stand at two heights in turn, so that neighbours are some degrees further apart than that.
    """
    width, height = round(640 / downscale), round(360 / downscale)
    spec = SyntheticSpec(kind=kind, cameras=len(_PLACES), width=width, height=height)
    target = np.array(spec.place.rig.target)
    cameras = []
    for number, angle in enumerate(np.radians(apart) * np.array(_PLACES)):
        aside = _RADIUS * np.array([np.sin(angle), -np.cos(angle), 0.0])
        eye = np.array([*(target + aside)[:2], _HEIGHT[number % 2]])
        pose = look_at(eye, target, np.array([0.0, 0.0, 1.0]))
        focal, middle = (_FOCAL * width, _FOCAL * width), (width / 2, height / 2)
        cameras.append(pinhole(f"cam{number:02d}", focal, middle, (width, height), pose))
    pictures = np.stack([render_view(spec, 0, camera) for camera in cameras])
    frame = FrameSet(0, 0, pictures, np.ones(len(cameras), np.bool_))
    return Subject(
        tuple(cameras), frame, first_points(frame, cameras, depth_bounds=None), [], spec, UNCHANGED, spec.fps
    )


def show(title: str, picture: Callable[[Camera], UInt8], subject: Subject, out: Path | None) -> None:
    """Print what `picture` is worth at every place, and save it there."""
    print(title)
    pictures, spec = subject.frame.images, subject.spec
    print(places_table(places(picture, subject.cameras, pictures, spec, subject.frame.index, subject.space)))
    for camera, truth in subject.held_out:
        score = score_picture(picture(camera), truth, Perception())
        print(f"  held out {camera.name}: {score.psnr:.2f} dB, SSIM {score.ssim:.4f}")
    if out is not None:
        save(title.split(":", maxsplit=1)[0].replace(" ", "-"), picture, subject, result_folder(out))
    print(flush=True)


def show_levels(scene: Scene, subject: Subject) -> None:
    """Print what a viewer sees at the cameras who has received the levels up to each, and what they take."""
    header, count = scene.header, len(scene.levels)
    empty = empty_level(header.feature_steps.size, header.gaussians_per_anchor)
    whole = len(encode_keyframe(scene, time_ns=0))
    for highest in range(count):
        cut = replace(scene, levels=scene.levels[: highest + 1] + (empty,) * (count - 1 - highest))
        share = len(encode_keyframe(cut, time_ns=0)) / whole
        quality = [
            psnr(draw(cut, camera), truth) for camera, truth in zip(subject.cameras, subject.frame.images, strict=True)
        ]
        print(f"  levels up to {highest}: {100 * share:3.0f} % of the bytes, {np.mean(quality):.2f} dB at the cameras")


def save(label: str, picture: Callable[[Camera], UInt8], subject: Subject, folder: Path) -> None:
    """What is seen at the cameras, and beside them where that is known, truth on the left."""
    shown = [(camera.name, camera, truth) for camera, truth in zip(subject.cameras, subject.frame.images, strict=True)]
    shown += [(f"{camera.name}-held-out", camera, truth) for camera, truth in subject.held_out]
    if subject.spec is not None:
        for share in BESIDE:
            for view in views_beside(subject.cameras, share):
                truth = true_view(subject.spec, subject.frame.index, subject.space.inverse().camera(view))
                shown.append((f"{view.name}-{share:g}-aside", view, truth))
    for place, camera, truth in shown:
        write_png(folder / f"{label}-{place}.png", side_by_side(truth, picture(camera)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="a recording, or wide:KIND[:DEGREES]")
    parser.add_argument("--downscale", type=float, default=2)
    parser.add_argument("--preset", default="live")
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--views", type=int)
    parser.add_argument("--test", nargs="*", default=[], help="cameras that are held out")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.data.startswith("wide:"):
        kind, _, apart = options.data.removeprefix("wide:").partition(":")
        subject = wide(kind, options.downscale, float(apart or 50))
    else:
        chosen = options.downscale, options.frame, options.views, tuple(options.test)
        subject = recorded(Path(options.data), *chosen)
    warm = changed(preset(options.preset), [*options.set, "steps=8", "growth_interval=2"])
    Trainer(subject.cameras, warm, subject.fps, "cpu").keyframe(subject.frame, subject.points)  # compiling is not timed
    for seed in range(options.seeds):
        config = changed(replace(preset(options.preset), seed=seed), options.set)
        begin = time.process_time()
        scene = Trainer(subject.cameras, config, subject.fps, "cpu").keyframe(subject.frame, subject.points).scene
        seconds = time.process_time() - begin
        levels = "+".join(str(len(level)) for level in scene.levels)
        size = f"{levels} anchors, {len(encode_keyframe(scene, time_ns=0)) / 1000:.0f} kB, {seconds:.0f} CPU s"
        show(f"{options.preset} seed {seed}: {size}", partial(draw, scene), subject, options.out)
        show_levels(scene, subject)
        if options.plain:
            model = PlainGaussians(subject.points, plain_views(subject.frame, subject.cameras), seed=seed)
            steps = model.train(seconds)
            show(f"plain seed {seed}: {len(model)} Gaussians, {steps} steps", model.picture, subject, options.out)


if __name__ == "__main__":
    main()
