"""Clips that begin in the dark."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.arrays import UInt8
from streamlod.core.frames import FrameSet
from streamlod.core.render.splatter import Splatter
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.stages.dark_start import contrast, is_worth_anew
from streamlod.server.pipeline.stages.opened import open_job
from streamlod.server.pipeline.stages.stream import train_stream
from tests.core.data.writers import write_colmap_binary, write_picture
from tests.server.brief import brief_training

CLIP = open_synthetic(SyntheticSpec(cameras=3, frames=3, width=48, height=28, seed=2))


def write_clip(folder: Path, light: tuple[float, ...]) -> TrainJob:
    """A job for the clip, of which each instant has so much light."""
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in CLIP.cameras]
    write_colmap_binary(folder / "sparse" / "0", entries, np.zeros((0, 6)))
    for frame, share in zip(CLIP.frames(), light, strict=True):
        for camera, image in zip(CLIP.cameras, frame.images, strict=True):
            write_picture(folder / "frames" / f"{frame.index:04d}" / f"{camera.name}.png", dimmed(image, share))
    return TrainJob(data=folder, preset="live")


def dimmed(image: UInt8, share: float) -> UInt8:
    return np.rint(share * image).astype(np.uint8)


@pytest.mark.parametrize("previews", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_clip_that_begins_in_black_is_shown_when_there_is_light(tmp_path: Path, previews: bool) -> None:
    decoder, kinds = SceneDecoder(), []
    with brief_training():
        opened = open_job(write_clip(tmp_path, (0, 1, 1)))
        for encoded in train_stream(opened, previews=previews):
            for packet in encoded.packets:
                decoder.push(packet)
            if not encoded.preview:
                kinds.append([peek(packet).kind for packet in encoded.packets])
    assert kinds == [[PacketKind.KEY], [PacketKind.KEY], [PacketKind.CHANGE]]
    assert decoder.scene is not None
    *_, last = opened.dataset.frames()
    shown = Splatter().picture(decoder.scene, opened.dataset.cameras[0])
    assert np.abs(shown.astype(int) - last.images[0]).mean() < 0.5 * last.images[0].mean()  # black has all of it


@pytest.mark.parametrize(("light", "expected"), [(0, PacketKind.KEY), (1, PacketKind.CHANGE)])
def test_a_scene_from_before_a_restart_is_begun_anew_if_it_was_dark(
    tmp_path: Path, light: float, expected: PacketKind
) -> None:
    """After a restart nobody remembers the first pictures: what the scene shows tells how dark they were."""
    with brief_training():
        opened, decoder = open_job(write_clip(tmp_path, (light, 1, 1))), SceneDecoder()
        with closing(train_stream(opened)) as frames:
            decoder.push(next(frames).packets[0])
        assert decoder.scene is not None
        opened = open_job(opened.job).continuing(decoder.scene)
        kinds = [peek(frame.packets[0]).kind for frame in train_stream(opened, resume=decoder.scene, start=1)]
    assert kinds == [expected, PacketKind.CHANGE]


def test_light_that_goes_off_and_on_begins_nothing_anew(tmp_path: Path) -> None:
    with brief_training():
        frames = list(train_stream(open_job(write_clip(tmp_path, (1, 0, 1)))))
    assert [[peek(packet).kind for packet in frame.packets] for frame in frames] == [
        [PacketKind.KEY], [PacketKind.CHANGE], [PacketKind.CHANGE],
    ]  # fmt: skip


def test_noise_and_missing_cameras_are_no_contrast() -> None:
    frame = next(CLIP.frames())
    noise = np.random.default_rng(0).normal(10, 6, frame.images.shape).clip(0, 255).astype(np.uint8)
    assert contrast(replace(frame, images=noise)) < 2
    assert contrast(frame) > 20
    nobody = FrameSet(0, 0, frame.images, np.zeros(len(frame.images), np.bool_))
    assert contrast(nobody) == 0


def test_a_scene_that_gets_brighter_is_begun_anew_a_few_times_only() -> None:
    first, times = 0.0, 0
    for bright in range(256):  # half of the picture; the last one has the most contrast that there is
        images = np.zeros((1, 16, 16, 3), np.uint8)
        images[:, :, 8:] = bright
        frame = FrameSet(0, 0, images, np.ones(1, np.bool_))
        if is_worth_anew(first, frame):
            first, times = contrast(frame), times + 1
    assert times == 2
