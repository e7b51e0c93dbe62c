"""Train one configuration on a split and measure every frame on the held-out cameras."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.footage import Footage
from streamlod.client.evaluation.measure.memory import forget_peak, peak_bytes
from streamlod.client.evaluation.measure.moving import MovingPixels, MovingScore, moving_score
from streamlod.client.evaluation.measure.places import places
from streamlod.client.evaluation.measure.scores import Perception, PictureScore, draw, score
from streamlod.client.evaluation.measure.sizes import (
    PacketSize,
    packet_size,
    shannon_keyframe_bytes,
    shannon_residual_bytes,
)
from streamlod.client.evaluation.measure.truth import MotionScore, dynamic_precision_recall
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import ModelError
from streamlod.core.frames import FrameSet
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from streamlod.core.synthetic import SyntheticSpec
from streamlod.core.train import (
    FrameReport,
    KeyframeConfig,
    ModelConfig,
    PredictConfig,
    TrainConfig,
    TrainedFrame,
    Trainer,
)

_log = logging.getLogger(__name__)
PERCEIVED = 4  # frames of a clip, evenly spread, on which the slow LPIPS is measured
_NO_TRAINING = FrameReport({}, 0, 0, 0, 0.0)


@dataclass(frozen=True, slots=True)
class TrainedScore:
    """One frame of one run: how it was trained, what it costs and how it looks.

    Attributes:
        frame: its number; 0 is the keyframe.
        picture: quality and rendering time on the held-out cameras.
        size: bytes of the real packet; shannon_bytes: the usual estimate.
        report: of the trainer. cpu_seconds: processor time of training, of all threads.
        motion: the dynamic set against the truth, None where there is no truth.
        moving: quality on moving pixels, None where nothing is known to move.
        anchors_before: alive before the frame; 0 before the first.
    """

    frame: int
    picture: PictureScore
    size: PacketSize
    shannon_bytes: float
    report: FrameReport
    cpu_seconds: float
    motion: MotionScore | None = None
    moving: MovingScore | None = None
    anchors_before: int = 0


@dataclass(frozen=True, slots=True)
class CapScore:
    """The last frame drawn with its `levels` coarsest levels only."""

    levels: int
    picture: PictureScore


@dataclass(frozen=True, slots=True, eq=False)
class SystemRun:
    """All that one configuration gave with one seed.

    Attributes:
        fps: frames a second of the footage.
        caps: quality of the last frame at every level cap.
        truth, drawn: [H,W,3] the first held-out camera's last picture and its rendering.
        peak_bytes: largest memory of the process while training and measuring.
        anchors: alive after the last frame.
        places: quality of the first frame at the cameras that trained, and beside them.
    """

    seed: int
    fps: float
    frames: tuple[TrainedScore, ...]
    caps: tuple[CapScore, ...]
    truth: UInt8
    drawn: UInt8
    peak_bytes: int
    anchors: int
    places: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class _FirstFrame:
    trained: TrainedFrame
    steps: PredictConfig
    peak_bytes: int
    cpu_seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class _TestedFrame:
    """A trained frame and what it is measured against.

    Attributes:
        trained: the frame.
        before: the state before; None for the first frame.
        training, testing: pictures of the cameras that trained, and of those held out.
        cpu_seconds: processor time of its training.
        peak_bytes: memory that the first frame's training took at most.
    """

    trained: TrainedFrame
    before: Scene | None
    training: FrameSet
    testing: FrameSet
    cpu_seconds: float
    peak_bytes: int


@dataclass(slots=True)
class FirstFrames:
    """Trained first frames of one split, shared by configurations that differ only in how later frames are trained."""

    device: str = "auto"
    _known: dict[tuple[ModelConfig, KeyframeConfig, int], _FirstFrame] = field(default_factory=dict)

    def get(self, footage: Footage, frame: FrameSet, config: TrainConfig) -> tuple[TrainedFrame, int, float]:
        """The first frame under `config`, with the peak memory in bytes and the processor time of its training."""
        key = (config.model, config.keyframe, config.seed)
        if key not in self._known:
            if not self._known:
                _rehearse(footage, config, self.device)
            forget_peak()
            begin = time.process_time()
            trained = _trainer(footage, config, self.device).keyframe(frame, footage.points)
            seconds = time.process_time() - begin
            self._known[key] = _FirstFrame(trained, config.predict, peak_bytes(), seconds)
        first = self._known[key]
        scene = with_steps(first.trained.scene, first.steps, config.predict)
        return replace(first.trained, scene=scene), first.peak_bytes, first.cpu_seconds


def _rehearse(footage: Footage, config: TrainConfig, device: str) -> None:
    """Train two frames in a few steps: none that is measured waits for what is compiled and loaded in them."""
    keyframe = replace(config.keyframe, steps=12, growth_interval=4)
    brief = replace(config, keyframe=keyframe, predict=replace(config.predict, epochs=1, minimum_steps=4))
    trainer = _trainer(footage, brief, device)
    first, *later = footage.training.frames(0, min(2, footage.frames))
    trainer.keyframe(first, footage.points)
    for frame in later:
        trainer.predict(frame)


def with_steps(scene: Scene, old: PredictConfig, new: PredictConfig) -> Scene:
    """A keyframe whose residuals are to be coded in the steps of `new`; the picture is the same."""
    header, weights = scene.header, scene.weights
    finer = np.float32(new.position_steps_per_cell / old.position_steps_per_cell)
    feature = np.float32(new.feature_step / old.feature_step) * weights.feature_decoder
    offset = np.float32(new.offset_step / old.offset_step) * weights.offset_decoder
    sendable = [decoder.astype(np.float16).astype(np.float32) for decoder in (feature, offset)]
    return replace(
        scene,
        header=replace(header, position_steps=header.position_steps / finer),
        weights=replace(weights, feature_decoder=sendable[0], offset_decoder=sendable[1]),
    )


def with_coarser_steps(config: TrainConfig, factor: float) -> TrainConfig:
    """The same training with steps of residuals `factor` times as wide; rates in steps change, so all moves as before.

    Positions learn in pixels, whatever their steps.
    """
    predict = replace(
        config.predict,
        feature_step=config.predict.feature_step * factor,
        offset_step=config.predict.offset_step * factor,
        position_steps_per_cell=max(round(config.predict.position_steps_per_cell / factor), 1),
        latent_rate=config.predict.latent_rate / factor,
    )
    return replace(config, predict=predict)


def perceived_frames(frames: int) -> set[int]:
    """The frames of a clip of so many on which LPIPS is measured."""
    return set(np.linspace(0, frames - 1, PERCEIVED).round().astype(int).tolist())


def run_system(
    config: TrainConfig,
    footage: Footage,
    first_frames: FirstFrames,
    *,
    frozen: bool = False,
    perception: Perception | None = None,
    spec: SyntheticSpec | None = None,
) -> SystemRun:
    """Train `config` (its seed included) over the footage and measure every frame.

    Args:
        frozen: show the first frame for ever.
        perception: LPIPS networks, used on a few frames spread over the clip.
        spec: of a synthetic clip, to compare the dynamic set with.

    Raises:
        ModelError: the footage has no frame with all held-out cameras, or training cannot go on.
    """
    by_distance = config.model.selection == "distance"
    perceived = perceived_frames(footage.frames)
    movers = MovingPixels(footage.testing.calibrated, spec)
    scores: list[TrainedScore] = []
    peak, scene, truth = 0, None, None
    stood: dict[str, Any] = {}
    for frame in _trained_frames(config, footage, first_frames, frozen):
        trained, before, testing = frame.trained, frame.before, frame.testing
        peak, scene = max(peak, frame.peak_bytes), trained.scene
        if not testing.present.all():
            _log.warning("frame %d is not measured: a held-out camera delivered nothing", testing.index)
            continue
        cameras, truth, index = footage.testing.cameras, testing.images, testing.index
        if not scores:
            stood = _at_cameras(scene, footage, frame.training, spec, by_distance=by_distance)  # compiling is not timed
        networks = perception if index in perceived else None
        picture, drawn = score(scene, cameras, truth, networks, by_distance=by_distance)
        moving = moving_score(drawn, truth, movers.masks(index, truth), networks.alex if networks else None)
        scores.append(
            TrainedScore(
                index,
                picture,
                packet_size(before, scene, trained.residual),
                _shannon_bytes(frame),
                trained.report,
                frame.cpu_seconds,
                _motion(frame, footage, spec),
                moving,
                0 if before is None else before.anchor_count,
            )
        )
    if scene is None or truth is None:
        raise ModelError("no frame could be measured: the held-out cameras delivered nothing")
    caps = tuple(
        CapScore(levels, score(scene, cameras, truth, highest_level=levels - 1, by_distance=by_distance)[0])
        for levels in range(1, len(scene.levels) + 1)
    )
    peak = max(peak, peak_bytes())
    return SystemRun(
        config.seed, footage.training.fps, tuple(scores), caps, truth[0], drawn[0], peak, scene.anchor_count, stood
    )


def _shannon_bytes(frame: _TestedFrame) -> float:
    """The usual estimate of what a frame costs."""
    if frame.before is None or frame.trained.residual is None:
        return shannon_keyframe_bytes(frame.trained.scene)
    return shannon_residual_bytes(frame.before, frame.trained.residual)


def _motion(frame: _TestedFrame, footage: Footage, spec: SyntheticSpec | None) -> MotionScore | None:
    """A later frame's dynamic set against the truth; None where there is no truth."""
    before, dynamic, rig = frame.before, frame.trained.dynamic, footage.training
    if before is None or frame.trained.residual is None or spec is None:
        return None
    if dynamic is None:
        dynamic = np.zeros(sum(map(len, before.levels)), np.bool_)
    return dynamic_precision_recall(spec, before, dynamic, frame.testing.index, rig.cameras, rig.calibrated)


def _at_cameras(
    scene: Scene, footage: Footage, training: FrameSet, spec: SyntheticSpec | None, *, by_distance: bool
) -> dict[str, Any]:
    present = np.flatnonzero(training.present).tolist()
    cameras = [footage.training.cameras[row] for row in present]

    def drawn(camera: Camera) -> UInt8:
        return draw(scene, camera, by_distance=by_distance)

    return places(drawn, cameras, training.images[present], spec, training.index, footage.training.space)


def _trained_frames(
    config: TrainConfig, footage: Footage, first_frames: FirstFrames, frozen: bool
) -> Iterator[_TestedFrame]:
    """Every frame, in order."""
    trainer = _trainer(footage, config, first_frames.device)
    peak = 0
    for training, testing in footage.pairs():
        if not trainer.has_state:
            first, peak, seconds = first_frames.get(footage, training, config)
            forget_peak()
            trainer.resume(first.scene)
            if not frozen and footage.frames > 1:
                # Motion is measured against the pictures of the frame predicted last. So the first frame is predicted
                # from itself, which makes its pictures the reference; what that trained is dropped.
                trainer.predict(training)
                trainer.resume(first.scene, keep_references=True)
            yield _TestedFrame(first, None, training, testing, seconds, peak)
        elif frozen:
            before = trainer.scene
            after = replace(before, version=training.index)
            trainer.resume(after)
            stood = TrainedFrame(after, difference(before, after), _NO_TRAINING)
            yield _TestedFrame(stood, before, training, testing, 0.0, peak)
        else:
            before, begin = trainer.scene, time.process_time()
            trained = trainer.predict(training)
            yield _TestedFrame(trained, before, training, testing, time.process_time() - begin, peak)


def _trainer(footage: Footage, config: TrainConfig, device: str) -> Trainer:
    training = footage.training
    return Trainer(training.cameras, config, training.fps, device)
